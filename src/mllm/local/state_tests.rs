//! A sequence is marked, branched and cut back whatever its layers keep: any order of these gives
//! the logits of a fresh run, bit for bit.

use super::Sequence;
use super::determinism_tests::random;
use crate::decoder::Logits;
use crate::family::VisionLanguageModel;
use proptest::prelude::*;
use serde_json::{Value, json};
use std::sync::LazyLock;

type Model = Box<dyn VisionLanguageModel>;

/// Models whose layers keep keys and values, a window of them, and states of their own.
static MODELS: LazyLock<Vec<Model>> = LazyLock::new(|| {
    let model = |family: &str, keys: Value| {
        let mut config = json!({"model_type": family, "hidden_size": 64, "intermediate_size": 96, "num_hidden_layers": 4,
            "num_attention_heads": 4, "num_key_value_heads": 2, "vocab_size": 128, "max_position_embeddings": 512});
        config
            .as_object_mut()
            .unwrap()
            .extend(keys.as_object().unwrap().clone());
        random(family, &config, &json!({}))
    };
    vec![
        model("qwen3", json!({"head_dim": 16})),
        model(
            "gemma3_text",
            json!({"head_dim": 16, "sliding_window": 7, "sliding_window_pattern": 2}),
        ),
        model(
            "gemma4_text",
            json!({"head_dim": 16, "global_head_dim": 32, "num_global_key_value_heads": 1, "attention_k_eq_v": true,
                "num_hidden_layers": 6, "sliding_window": 7, "num_kv_shared_layers": 2, "use_double_wide_mlp": true,
                "hidden_size_per_layer_input": 8, "vocab_size_per_layer_input": 128, "final_logit_softcapping": 5.0,
                "layer_types": ["sliding_attention", "full_attention", "sliding_attention", "full_attention",
                    "sliding_attention", "full_attention"]}),
        ),
        model(
            "gemma3n_text",
            json!({"model_type": "gemma3n_text", "head_dim": 16, "num_hidden_layers": 6, "sliding_window": 7,
                "num_kv_shared_layers": 2, "hidden_size_per_layer_input": 8, "vocab_size_per_layer_input": 100,
                "laurel_rank": 8, "activation_sparsity_pattern": [0.7, 0, 0.5, 0, 0, 0],
                "layer_types": ["sliding_attention", "full_attention", "sliding_attention", "full_attention",
                    "sliding_attention", "full_attention"]}),
        ),
        model(
            "lfm2",
            json!({"layer_types": ["conv", "full_attention", "conv", "conv"], "conv_L_cache": 4}),
        ),
        model(
            "qwen3_5_text",
            json!({"head_dim": 16, "partial_rotary_factor": 0.5, "rope_parameters": {"mrope_section": [2, 1, 1]},
                "full_attention_interval": 3, "linear_num_key_heads": 2, "linear_num_value_heads": 4,
                "linear_key_head_dim": 8, "linear_value_head_dim": 12}),
        ),
    ]
});

#[derive(Debug, Clone)]
enum Action {
    /// Appends tokens in passes of this many.
    Append(Vec<u32>, usize),
    /// Begins a prompt: so many of the known tokens, then others.
    Begin(usize, Vec<u32>),
    Mark,
    Cut(usize),
    Branch,
    Turn(usize),
}

fn actions() -> impl Strategy<Value = Vec<Action>> {
    let tokens = |most| prop::collection::vec(0_u32..120, 1..most);
    let action = prop_oneof![
        4 => (tokens(30), 1_usize..8).prop_map(|(tokens, pass)| Action::Append(tokens, pass)),
        2 => (0_usize..60, tokens(12)).prop_map(|(kept, tokens)| Action::Begin(kept, tokens)),
        2 => Just(Action::Mark),
        3 => (0_usize..60).prop_map(Action::Cut),
        1 => Just(Action::Branch),
        2 => (0_usize..3).prop_map(Action::Turn),
    ];
    prop::collection::vec(action, 1..14)
}

/// Appends tokens in passes that round as passes of one; gives the bits behind the last.
fn append(
    model: &dyn VisionLanguageModel,
    sequence: &mut Sequence,
    tokens: &[u32],
    pass: usize,
) -> Vec<u32> {
    let mut bits = Vec::new();
    for part in tokens.chunks(pass.min(model.decoder().exact_pass())) {
        let logits = sequence.append(model, part, None, Logits::Last).unwrap();
        let logits: Vec<f32> = logits.unwrap().flatten_all().unwrap().to_vec1().unwrap();
        bits = logits.into_iter().map(f32::to_bits).collect();
    }
    bits
}

/// A branch, and the tokens that it holds.
type Branch = (Sequence, Vec<u32>);

fn act(
    model: &dyn VisionLanguageModel,
    branches: &mut Vec<Branch>,
    at: &mut usize,
    action: &Action,
) {
    let count = branches.len();
    let (sequence, known) = &mut branches[*at];
    match action {
        Action::Append(tokens, pass) => {
            append(model, sequence, tokens, *pass);
            known.extend(tokens);
        }
        Action::Begin(kept, tokens) => {
            let prompt = [&known[..(*kept).min(known.len())], tokens].concat();
            let kept = sequence.begin(model, &prompt, &[]);
            append(model, sequence, &prompt[kept..], 5);
            *known = prompt;
        }
        Action::Mark => sequence.mark(),
        Action::Cut(len) => {
            let again = sequence.cut(*len);
            append(model, sequence, &again, 4);
            known.truncate(*len);
        }
        Action::Branch if count < 3 => {
            let copy = branches[*at].clone();
            branches.push(copy);
        }
        Action::Branch => {}
        Action::Turn(to) => *at = to % count,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_order_of_append_mark_cut_and_branch_gives_the_bits_of_a_fresh_run(actions in actions()) {
        for model in &*MODELS {
            let model = &**model;
            let (mut branches, mut at) = (vec![(Sequence::new(model), Vec::new())], 0);
            for action in &actions {
                act(model, &mut branches, &mut at, action);
            }
            for (mut sequence, known) in branches {
                prop_assert_eq!(sequence.ids(), known.as_slice());
                let mut fresh = Sequence::new(model);
                append(model, &mut fresh, &known, 8);
                let next = [9, 8, 7];
                let found = append(model, &mut sequence, &next, 1);
                prop_assert_eq!(found, append(model, &mut fresh, &next, 3), "{}", model.info().architecture);
            }
        }
    }
}
