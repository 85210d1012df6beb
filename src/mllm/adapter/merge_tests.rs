//! Merging with numbers of our own making, against the formulas in f64.

use super::test_adapter::{Made, embedding_pair, made, merge, numbers, pair, peft, weights};
use crate::checkpoint::Weights;
use serde_json::{Value, json};

const Q: &str = "model.layers.0.self_attn.q_proj";
const EMBEDDING: &str = "model.embed_tokens";
const OUTPUT: &str = "lm_head";
const QKV: &str = "visual.blocks.0.attn.qkv";

/// W + s B A in f64, for outputs as rows.
fn product(base: &Made, [a, b]: &[Made; 2], scale: f64) -> Vec<f64> {
    let (inputs, rank) = (a.1[1..].iter().product::<usize>(), a.1[0]);
    let mut result: Vec<f64> = base.2.iter().map(|value| f64::from(*value)).collect();
    for (at, value) in result.iter_mut().enumerate() {
        let (row, column) = (at / inputs, at % inputs);
        let sum: f64 = (0..rank)
            .map(|k| f64::from(b.2[row * rank + k]) * f64::from(a.2[k * inputs + column]))
            .sum();
        *value += scale * sum;
    }
    result
}

fn assert_near(found: &[f32], expected: &[f64], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (found, expected) in found.iter().zip(expected) {
        let error = (f64::from(*found) - expected).abs();
        assert!(error < 2e-6, "{what}: {found} is not {expected}");
    }
}

/// The merged tensor of a module with these settings.
fn merged(settings: &Value, base: &Made, tensors: &[Made]) -> Vec<f32> {
    let folder = peft(settings, tensors);
    let mut weights = weights(std::slice::from_ref(base));
    merge(folder.path(), &mut weights).unwrap();
    numbers(&mut weights, &base.0, &base.1)
}

#[test]
fn scales_follow_rank_alpha_and_patterns() {
    let base = made(&format!("{Q}.weight"), &[6, 10]);
    for (settings, rank, scale) in [
        (json!({}), 4, 6.0 / 4.0),
        (json!({"use_rslora": true}), 4, 6.0 / 2.0),
        (json!({"rank_pattern": {"q_proj": 2}}), 2, 6.0 / 2.0),
        (
            json!({"rank_pattern": {"k_proj": 2, r"layers\.0\..*": 3, "q_proj": 5}, "alpha_pattern": {"^model.layers.0.self_attn.q_proj": 9}}),
            3,
            9.0 / 3.0,
        ),
        (
            json!({"alpha_pattern": {"proj": 9, "o_proj|q_proj": 2}, "use_rslora": true}),
            4,
            2.0 / 2.0,
        ),
        (
            json!({"lora_alpha": 0.5, "fan_in_fan_out": true}),
            4,
            0.5 / 4.0,
        ),
    ] {
        let pair = pair(Q, [6, 10], rank);
        let found = merged(&settings, &base, &pair);
        assert_near(&found, &product(&base, &pair, scale), &settings.to_string());
    }
}

#[test]
fn convolutions_are_matrices_of_their_kernels() {
    let module = "model.vision_tower.embeddings.patch_embedding";
    let base = made(&format!("{module}.weight"), &[5, 3, 2, 2]);
    let tensors = [
        made(
            &format!("base_model.model.{module}.lora_A.weight"),
            &[4, 3, 2, 2],
        ),
        made(
            &format!("base_model.model.{module}.lora_B.weight"),
            &[5, 4, 1, 1],
        ),
    ];
    let found = merged(&json!({}), &base, &tensors);
    assert_near(&found, &product(&base, &tensors, 1.5), "convolution");
}

#[test]
fn dora_gives_each_output_the_length_of_its_magnitude() {
    let base = made(&format!("{Q}.weight"), &[6, 10]);
    let magnitude = made(&format!("base_model.model.{Q}.lora_magnitude_vector"), &[6]);
    let pair = pair(Q, [6, 10], 4);
    let tensors = [pair[0].clone(), pair[1].clone(), magnitude.clone()];
    let found = merged(&json!({"use_dora": true}), &base, &tensors);
    let mut expected = product(&base, &pair, 1.5);
    for (row, length) in expected.chunks_mut(10).zip(&magnitude.2) {
        let norm = row.iter().map(|value| value * value).sum::<f64>().sqrt();
        for value in row {
            *value *= f64::from(*length) / norm;
        }
    }
    assert_near(&found, &expected, "DoRA");
}

/// The columns of a matrix as rows.
fn turned(base: &Made) -> Made {
    let (rows, columns) = (base.1[0], base.1[1]);
    let numbers = (0..rows * columns).map(|at| base.2[at % rows * columns + at / rows]);
    (base.0.clone(), vec![columns, rows], numbers.collect())
}

#[test]
fn embeddings_and_layers_of_gpt2_have_their_outputs_as_columns() {
    let base = made(&format!("{EMBEDDING}.weight"), &[12, 6]);
    let pair_of_embedding = embedding_pair(EMBEDDING, [12, 6], 4);
    let found = merged(&json!({}), &base, &pair_of_embedding);
    let expected = product(&turned(&base), &pair_of_embedding, 1.5);
    let back: Vec<f64> = (0..72).map(|at| expected[at % 6 * 12 + at / 6]).collect();
    assert_near(&found, &back, "embedding");

    let base = made("transformer.h.0.attn.c_attn.weight", &[5, 15]);
    let pair = pair("transformer.h.0.attn.c_attn", [15, 5], 4);
    let found = merged(&json!({"fan_in_fan_out": true}), &base, &pair);
    let expected = product(&turned(&base), &pair, 1.5);
    let back: Vec<f64> = (0..75).map(|at| expected[at % 15 * 5 + at / 15]).collect();
    assert_near(&found, &back, "Conv1D");
}

#[test]
fn parameters_biases_and_tokens_take_the_place_of_the_base() {
    let base = [
        made(&format!("{Q}.weight"), &[6, 10]),
        made(&format!("{Q}.bias"), &[6]),
        made("model.norm.weight", &[10]),
        made(&format!("{EMBEDDING}.weight"), &[12, 10]),
    ];
    let [a, b] = pair(Q, [6, 10], 4);
    let own = [
        made(&format!("base_model.model.{Q}.base_layer.bias"), &[6]),
        made(&format!("base_model.model.{Q}.lora_B.bias"), &[6]),
        made("base_model.model.model.norm.weight", &[10]),
        made(
            &format!("base_model.model.{EMBEDDING}.token_adapter.trainable_tokens_delta"),
            &[2, 10],
        ),
    ];
    let tensors = [vec![a, b], own.to_vec()].concat();
    let settings = json!({"bias": "lora_only", "lora_bias": true, "modules_to_save": ["norm"], "trainable_token_indices": [7, 3]});
    let folder = peft(&settings, &tensors);
    let mut weights = weights(&base);
    let report = merge(folder.path(), &mut weights).unwrap();
    assert_eq!(
        (report.tensors, report.base.as_deref()),
        (4, Some("org/base"))
    );
    assert_eq!(numbers(&mut weights, "model.norm.weight", &[10]), own[2].2);
    let bias: Vec<f64> = own[0]
        .2
        .iter()
        .zip(&own[1].2)
        .map(|(bias, added)| f64::from(*bias) + 1.5 * f64::from(*added))
        .collect();
    let found = numbers(&mut weights, &format!("{Q}.bias"), &[6]);
    assert_near(&found, &bias, "bias");
    let mut rows = base[3].2.clone();
    rows[70..80].copy_from_slice(&own[3].2[..10]);
    rows[30..40].copy_from_slice(&own[3].2[10..]);
    let found = numbers(&mut weights, &format!("{EMBEDDING}.weight"), &[12, 10]);
    assert_eq!(found, rows);
}

/// The output layer that the weights have behind a merge; none where it is the embedding.
fn output(settings: &Value, tensors: &[Made], base: &[Made]) -> (Option<Vec<f32>>, Vec<f32>) {
    let folder = peft(settings, tensors);
    let mut weights: Weights = weights(base);
    merge(folder.path(), &mut weights).unwrap();
    let name = format!("{OUTPUT}.weight");
    let own = weights
        .contains(&name)
        .then(|| numbers(&mut weights, &name, &[12, 6]));
    (
        own,
        numbers(&mut weights, &format!("{EMBEDDING}.weight"), &[12, 6]),
    )
}

#[test]
fn tied_embeddings_part_where_training_parted_them() {
    let base = [made(&format!("{EMBEDDING}.weight"), &[12, 6])];
    let low_rank = embedding_pair(EMBEDDING, [12, 6], 4);
    let (own, embedding) = output(&json!({}), &low_rank, &base);
    assert_eq!(
        own.as_deref(),
        Some(&base[0].2[..]),
        "the output keeps the base's numbers"
    );
    assert_ne!(embedding, base[0].2);
    let (own, _) = output(&json!({"ensure_weight_tying": true}), &low_rank, &base);
    assert_eq!(own, None);

    let tokens = [made(
        &format!("base_model.model.{EMBEDDING}.token_adapter.trainable_tokens_delta"),
        &[1, 6],
    )];
    let settings = json!({"trainable_token_indices": {"embed_tokens": [2]}});
    assert_eq!(output(&settings, &tokens, &base).0, None);

    let head = [made(&format!("base_model.model.{OUTPUT}.weight"), &[12, 6])];
    let (own, embedding) = output(&json!({"modules_to_save": [OUTPUT]}), &head, &base);
    assert_eq!(
        (own.as_deref(), embedding),
        (Some(&head[0].2[..]), base[0].2.clone())
    );

    let saved = [made(
        &format!("base_model.model.{EMBEDDING}.weight"),
        &[12, 6],
    )];
    let (own, _) = output(&json!({"modules_to_save": ["embed_tokens"]}), &saved, &base);
    assert_eq!(own.as_deref(), Some(&base[0].2[..]));
    // A copy that PEFT saves beside others is no module of its own.
    assert_eq!(output(&json!({}), &saved, &base).0, None);
}

#[test]
fn projections_of_a_tower_are_found_fused_and_apart() {
    let parts = ["q_proj", "k_proj", "v_proj"];
    let apart: Vec<Made> = parts
        .iter()
        .map(|part| made(&format!("visual.blocks.0.attn.{part}.weight"), &[4, 6]))
        .collect();
    let numbers_of = |mades: &[Made]| mades.iter().flat_map(|made| made.2.clone()).collect();
    let fused = (format!("{QKV}.weight"), vec![12, 6], numbers_of(&apart));
    let whole = pair(QKV, [12, 6], 4);
    let expected = product(&fused, &whole, 1.5);
    let folder = peft(&json!({}), &whole);
    let mut split = weights(&apart);
    merge(folder.path(), &mut split).unwrap();
    for (part, expected) in apart.iter().zip(expected.chunks(24)) {
        assert_near(&numbers(&mut split, &part.0, &[4, 6]), expected, &part.0);
    }

    let single = pair("visual.blocks.0.attn.k_proj", [4, 6], 4);
    let folder = peft(&json!({}), &single);
    let mut joined = weights(std::slice::from_ref(&fused));
    merge(folder.path(), &mut joined).unwrap();
    let found = numbers(&mut joined, &fused.0, &[12, 6]);
    let middle = product(&apart[1], &single, 1.5);
    assert_near(&found[24..48], &middle, "fused");
    assert_eq!(
        (&found[..24], &found[48..]),
        (&fused.2[..24], &fused.2[48..])
    );
}

/// A matrix of noise with the numbers of its start taken away, as a trainer saves it.
#[test]
fn pissa_and_olora_take_their_start_from_the_base() {
    // Two orthogonal parts of very different size, so that the larger is the leading one.
    let [left, right] = [[0.5_f32; 4], [0.5, 0.5, -0.5, -0.5]];
    let numbers: Vec<f32> = (0..16)
        .map(|at| 8.0 * left[at / 4] * left[at % 4] + 0.1 * right[at / 4] * right[at % 4])
        .collect();
    let base = (format!("{Q}.weight"), vec![4, 4], numbers);
    let zeros = |name: &str, shape: [usize; 2]| {
        let name = format!("base_model.model.{Q}.{name}.weight");
        (name, shape.to_vec(), vec![0.0_f32; 4])
    };
    let tensors = [zeros("lora_A", [1, 4]), zeros("lora_B", [4, 1])];
    let rest: Vec<f64> = (0..16)
        .map(|at| f64::from(0.1 * right[at / 4] * right[at % 4]))
        .collect();
    for init in ["pissa", "PiSSA", "pissa_niter_4"] {
        let settings = json!({"init_lora_weights": init, "r": 1});
        assert_near(&merged(&settings, &base, &tensors), &rest, init);
    }
    // The first column's part, times the scale of 6.
    let first: Vec<f64> = (0..4).map(|row| f64::from(base.2[row * 4])).collect();
    let length = first.iter().map(|value| value * value).sum::<f64>();
    let expected: Vec<f64> = (0..16)
        .map(|at| {
            let column = at % 4;
            let along: f64 = (0..4)
                .map(|row| first[row] * f64::from(base.2[row * 4 + column]))
                .sum();
            f64::from(base.2[at]) - 6.0 * first[at / 4] * along / length
        })
        .collect();
    let settings = json!({"init_lora_weights": "olora", "r": 1});
    let found = merged(&settings, &base, &tensors);
    for (found, expected) in found.iter().zip(&expected) {
        assert!(
            (f64::from(*found) - expected).abs() < 1e-5,
            "{found} is not {expected}"
        );
    }
}

#[test]
fn modules_that_the_settings_name_and_the_file_lacks_are_told() {
    let layers = |part: &str| -> Vec<Made> {
        let names = (0..3).map(|layer| format!("model.layers.{layer}.self_attn.{part}.weight"));
        names.map(|name| made(&name, &[6, 10])).collect()
    };
    let base: Vec<Made> = [layers("q_proj"), layers("k_proj"), layers("o_proj")].concat();
    let two = [
        pair(Q, [6, 10], 4),
        pair("model.layers.2.self_attn.q_proj", [6, 10], 4),
    ]
    .concat();
    for (settings, said) in [
        (json!({}), Some("4 modules that target_modules names")),
        (
            json!({"target_modules": ["q_proj"]}),
            Some("stay as they are: model.layers.1.self_attn.q_proj"),
        ),
        (
            json!({"target_modules": ["q_proj"], "layers_to_transform": [0, 2]}),
            None,
        ),
        (json!({"target_modules": r".*\.[02]\..*"}), None),
    ] {
        let folder = peft(&settings, &two);
        let mut weights = weights(&base);
        merge(folder.path(), &mut weights).unwrap();
        let notes = weights.report().notes.clone();
        let told = notes.iter().find(|note| note.contains("no tensors"));
        match said {
            Some(said) => assert!(told.is_some_and(|note| note.contains(said)), "{notes:?}"),
            None => assert_eq!(told, None, "{settings}"),
        }
    }
}
