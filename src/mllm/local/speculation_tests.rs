//! Drafts change no answer: the numbers of a pass of several tokens are those of passes of one, and
//! so are the tokens.

use super::test_reference::fixture;
use super::{Loading, LocalModel, Sequence};
use crate::decoder::Logits;
use crate::family::VisionLanguageModel;
use crate::source::ModelPlace;
use crate::{
    Answer, Constraint, Deadline, Mllm, ModelShape, PromptPrefix, Request, Sampling, TokenCounts,
    WeightFormat,
};
use std::path::{Path, PathBuf};

const GREEDY: Sampling = Sampling::Greedy;
const WARM: Sampling = Sampling::Sample {
    temperature: 1.5,
    top_p: 0.95,
};
const FORMATS: [WeightFormat; 3] = [WeightFormat::F32, WeightFormat::F16, WeightFormat::Q8_0];

/// A checkpoint of every family, with its image.
fn folders() -> Vec<(PathBuf, &'static str)> {
    let papers = [
        "tiny_llava",
        "tiny_llava_next",
        "tiny_llava_next_mistral",
        "tiny_cogvlm",
    ];
    let papers = papers.into_iter().map(|name| (fixture(name), "image.png"));
    let todays = [
        "tiny_smolvlm",
        "tiny_internvl3",
        "tiny_qwen3_vl",
        "tiny_qwen2_5_vl",
        "tiny_qwen2_vl",
        "tiny_llava_onevision",
        "tiny_gemma3",
        "tiny_gemma3n_vision",
        "tiny_gemma4",
        "tiny_lfm2_vl",
        "tiny_qwen3_5",
    ];
    papers
        .chain(todays.map(|name| (fixture(name), "image_0.png")))
        .collect()
}

fn open(folder: &Path, quantize: Option<WeightFormat>) -> LocalModel {
    let loading = Loading {
        quantize,
        ..Loading::default()
    };
    LocalModel::load("tiny", &ModelPlace::Folder(folder.to_path_buf()), &loading).unwrap()
}

/// Three rounds of a call: free, a form with choices and a reason, a choice behind fixed text.
fn constraints() -> [Constraint; 3] {
    let form = r"Speed: (up|down|same)\nLane: (left|right|keep)\nReason: [a-z ]{3,12}";
    let choice = ["left", "right", "keep"].map(|word| format!("go({word}, v=1)"));
    [
        Constraint::Free,
        Constraint::Regex(form.into()),
        Constraint::Choice(choice.into()),
    ]
}

/// The answers to three rounds, each with a draft.
fn ask(
    local: &LocalModel,
    prefix: &PromptPrefix,
    sampling: Sampling,
    drafts: Option<&[Vec<u32>]>,
) -> Vec<Answer> {
    let mut conversation = local.converse(prefix, 5).unwrap();
    let rounds = constraints()
        .into_iter()
        .enumerate()
        .map(|(round, constraint)| {
            let draft = drafts.map(|drafts| drafts[round].clone());
            let request = Request {
                constraint,
                max_new_tokens: 40,
                sampling,
                deadline: Deadline::NONE,
                draft,
            };
            conversation
                .ask(
                    ["What is ahead?", "What now?", "Write it."][round],
                    &request,
                )
                .unwrap()
        });
    rounds.collect()
}

/// All that must not depend on drafts.
fn answered(answers: &[Answer]) -> Vec<(&str, &[u32], TokenCounts)> {
    let counts = |answer: &Answer| TokenCounts {
        drafted: 0,
        accepted: 0,
        ..answer.tokens
    };
    answers
        .iter()
        .map(|answer| (answer.text.as_str(), answer.ids.as_slice(), counts(answer)))
        .collect()
}

fn sum(answers: &[Answer], of: fn(&TokenCounts) -> usize) -> usize {
    answers.iter().map(|answer| of(&answer.tokens)).sum()
}

#[test]
fn answers_are_the_same_tokens_with_and_without_drafts_in_every_family() {
    // Accepted tokens of drafts that are the answer, nearly the answer, and unknown; sampled
    // tokens.
    let (mut accepted, mut chosen) = ([0; 3], 0);
    for (folder, image) in folders() {
        let image = image::open(folder.join(image)).unwrap().into_rgb8();
        let prefix = PromptPrefix {
            system: "Drive safely.".into(),
            image: Some(image.into()),
        };
        for format in FORMATS {
            let local = open(&folder, Some(format));
            let name = format!("{} {format}", folder.display());
            for sampling in [GREEDY, WARM] {
                let plain = ask(&local, &prefix, sampling, None);
                assert_eq!(sum(&plain, |tokens| tokens.drafted), 0, "{name}");
                let known: Vec<Vec<u32>> = plain.iter().map(|answer| answer.ids.clone()).collect();
                let wrong: Vec<Vec<u32>> = known
                    .iter()
                    .map(|ids| {
                        ids.iter()
                            .enumerate()
                            .map(|(i, id)| if i % 5 == 3 { id ^ 1 } else { *id })
                            .collect()
                    })
                    .collect();
                let nothing = vec![Vec::new(); known.len()];
                for (drafts, accepted) in [known, wrong, nothing].iter().zip(&mut accepted) {
                    let drafted = ask(&local, &prefix, sampling, Some(drafts));
                    assert_eq!(answered(&drafted), answered(&plain), "{name} {sampling:?}");
                    let kept = sum(&drafted, |tokens| tokens.accepted);
                    assert!(
                        kept <= sum(&drafted, |tokens| tokens.drafted),
                        "{name} {sampling:?}: {kept}"
                    );
                    *accepted += kept;
                }
                chosen += sum(&plain, |tokens| tokens.sampled);
            }
        }
    }
    assert!(
        accepted[0] > accepted[1] && accepted[1] > 0 && 2 * accepted[0] > chosen,
        "{accepted:?} of {chosen}"
    );
}

#[test]
fn nothing_is_drafted_where_a_longer_pass_rounds_differently() {
    // A sliding window cuts the positions of each token elsewhere.
    let folder = fixture("tiny_llava_next_mistral");
    let local = open(&folder, None);
    let plain = ask(&local, &PromptPrefix::default(), GREEDY, None);
    let known: Vec<Vec<u32>> = plain.iter().map(|answer| answer.ids.clone()).collect();
    let again = ask(&local, &PromptPrefix::default(), GREEDY, Some(&known));
    assert_eq!(answered(&again), answered(&plain));
    assert_eq!(
        (
            local.model.decoder().exact_pass(),
            sum(&again, |tokens| tokens.drafted)
        ),
        (1, 0)
    );
}

/// The bits of the logits after each of the last tokens, in passes of these lengths.
fn bits(model: &dyn VisionLanguageModel, known: usize, passes: &[usize]) -> Vec<Vec<u32>> {
    let mut sequence = Sequence::new(model);
    let ids: Vec<u32> = (0..800).map(|index| 4 + index * 7 % 500).collect();
    sequence
        .append(model, &ids[..known], None, Logits::None)
        .unwrap();
    let mut found = Vec::new();
    for &length in passes {
        let from = sequence.ids().len();
        let logits = sequence
            .append(model, &ids[from..from + length], None, Logits::Tail(length))
            .unwrap();
        let rows = logits.unwrap().to_vec2::<f32>().unwrap();
        found.extend(
            rows.into_iter()
                .map(|row| row.into_iter().map(f32::to_bits).collect::<Vec<_>>()),
        );
    }
    found
}

#[test]
fn a_pass_of_several_tokens_gives_the_bits_of_passes_of_one() {
    // The known tokens end before a block of keys, and before the positions that a second unit of
    // work attends to.
    for format in FORMATS {
        let place = ModelPlace::Random {
            shape: ModelShape::find("nano").unwrap(),
            seed: 3,
        };
        let loading = Loading {
            quantize: Some(format),
            ..Loading::default()
        };
        let model = loading.checkpoint(&place).unwrap().open_model().unwrap();
        assert!(model.decoder().exact_pass() >= 17);
        for known in [58, 506] {
            let single = bits(&*model, known, &[1; 17]);
            for passes in [&[17][..], &[2, 3, 12], &[9, 1, 7]] {
                let several = bits(&*model, known, passes);
                let differ = several.iter().zip(&single).position(|(a, b)| a != b);
                assert_eq!(
                    (several.len(), differ),
                    (17, None),
                    "{format}: {passes:?} after {known} tokens"
                );
            }
        }
    }
}

/// Of equal seeds, sampled tokens are the same with and without drafts, so they follow the same
/// distribution.
#[test]
fn answers_are_the_same_tokens_with_and_without_a_draft_model() {
    let folder = fixture("tiny_llava");
    let image = image::open(folder.join("image.png")).unwrap().into_rgb8();
    let seen = PromptPrefix {
        system: "Drive safely.".into(),
        image: Some(image.into()),
    };
    let unseen = PromptPrefix {
        image: None,
        ..seen.clone()
    };
    let place = ModelPlace::Folder(folder.clone());
    let (mut with_model, mut without) = (0, 0);
    for format in FORMATS {
        let plain = open(&folder, Some(format));
        // The same weights with other roundings, and without the image: some of its tokens are
        // chosen, and not all.
        let drafted = open(&folder, Some(format))
            .with_draft_model(&place, &Loading::default())
            .unwrap();
        for (prefix, sampling) in [
            (&seen, GREEDY),
            (&seen, WARM),
            (&unseen, GREEDY),
            (&unseen, WARM),
        ] {
            let expected = ask(&plain, prefix, sampling, None);
            let nothing = vec![Vec::new(); expected.len()];
            let found = ask(&drafted, prefix, sampling, Some(&nothing));
            assert_eq!(
                answered(&found),
                answered(&expected),
                "{format} {sampling:?}"
            );
            with_model += sum(&found, |tokens| tokens.accepted);
            without += sum(&ask(&plain, prefix, sampling, Some(&nothing)), |tokens| {
                tokens.accepted
            });
        }
    }
    assert!(
        with_model > 10 * without.max(1),
        "{with_model} with it, {without} without it"
    );
}

#[test]
fn a_draft_model_has_the_vocabulary_of_its_model() {
    let folder = fixture("tiny_llava");
    let copy = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        std::fs::copy(&path, copy.path().join(path.file_name().unwrap())).unwrap();
    }
    let path = copy.path().join("tokenizer.json");
    let mut json: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    let vocabulary = json["model"]["vocab"].as_object_mut().unwrap();
    let tokens: Vec<String> = vocabulary
        .keys()
        .filter(|token| token.chars().count() == 1)
        .cloned()
        .collect();
    let [one, other] = [&tokens[5], &tokens[9]];
    let (id, swapped) = (vocabulary[one].clone(), vocabulary[other].clone());
    (vocabulary[one], vocabulary[other]) = (swapped, id.clone());
    std::fs::write(&path, json.to_string()).unwrap();
    let model = open(&folder, Some(WeightFormat::F16));
    let error = model.with_draft_model(
        &ModelPlace::Folder(copy.path().to_path_buf()),
        &Loading::default(),
    );
    let error = error.unwrap_err().to_string();
    let first = format!(
        "its token {} is ",
        id.as_u64()
            .unwrap()
            .min(json["model"]["vocab"][one].as_u64().unwrap())
    );
    assert!(
        error.contains("draft_model") && error.contains(&first),
        "{error}"
    );
}
