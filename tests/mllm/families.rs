//! Every family through the registry, in conversations with rounds and rethinks, and in the agent.

use super::{Copy, FIRST, SECOND, fixture, free, request};
use image::RgbImage;
use planagent_agent::planner::{
    AfterMaxExec, CodeSource, PlanAgent, PlanAgentSettings, Planner, PlannerName,
    ReflectionSettings,
};
use planagent_agent::reasoning::{PromptSet, Proposals, ReasoningSettings, Round, Speculation};
use planagent_agent::simulation::{Challenge, simulate};
use planagent_mllm::{
    Architecture, Constraint, Families, FinishReason, GenerationSettings, HubAccess, Mllm,
    MllmError, ModelRegistry, ModelSource, PromptPrefix, RoundTokens, Sampling, Trust,
};
use planagent_scenario::generator;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Every family's tiny checkpoint.
const FAMILIES: [Tiny; 15] = [
    Tiny {
        name: "tiny_llava",
        architecture: "llava",
    },
    Tiny {
        name: "tiny_llava_next",
        architecture: "llava-next",
    },
    Tiny {
        name: "tiny_llava_next_mistral",
        architecture: "llava-next",
    },
    Tiny {
        name: "tiny_cogvlm",
        architecture: "cogvlm",
    },
    Tiny {
        name: "tiny_smolvlm",
        architecture: "smolvlm",
    },
    Tiny {
        name: "tiny_internvl3",
        architecture: "internvl",
    },
    Tiny {
        name: "tiny_qwen3_vl",
        architecture: "qwen3-vl",
    },
    Tiny {
        name: "tiny_qwen2_5_vl",
        architecture: "qwen2.5-vl",
    },
    Tiny {
        name: "tiny_qwen2_vl",
        architecture: "qwen2-vl",
    },
    Tiny {
        name: "tiny_llava_onevision",
        architecture: "llava-onevision",
    },
    Tiny {
        name: "tiny_gemma3",
        architecture: "gemma3",
    },
    Tiny {
        name: "tiny_gemma3n_vision",
        architecture: "gemma3n",
    },
    Tiny {
        name: "tiny_gemma4",
        architecture: "gemma4",
    },
    Tiny {
        name: "tiny_lfm2_vl",
        architecture: "lfm2-vl",
    },
    Tiny {
        name: "tiny_qwen3_5",
        architecture: "qwen3.5",
    },
];

/// A tiny checkpoint with references.
struct Tiny {
    /// Its folder.
    name: &'static str,
    architecture: &'static str,
}

/// The checkpoints and their folders.
fn families() -> impl Iterator<Item = (&'static Tiny, PathBuf)> {
    FAMILIES.iter().map(|tiny| (tiny, fixture(tiny.name)))
}

/// Families without a vision tower, which the decoders of the others are checkpoints of
/// (`src/mllm/local/text_only_tests.rs`), but for some of Gemma and LFM2.
const TEXT_ONLY: [&str; 8] = [
    "llama",
    "qwen2",
    "qwen3",
    "qwen3_5_text",
    "gemma3_text",
    "gemma3n_text",
    "gemma4_text",
    "lfm2",
];

#[test]
fn every_family_has_a_checkpoint() {
    for family in Families::default().iter() {
        assert!(
            TEXT_ONLY.contains(&family.name())
                || FAMILIES
                    .iter()
                    .any(|tiny| tiny.architecture == family.name()),
            "{}",
            family.name()
        );
    }
}

#[test]
fn the_agent_plans_by_the_text_alone_with_a_model_that_sees_nothing() {
    let copy = Copy::from_fixture("tiny_gemma3_text");
    copy.edit("config.json", |config| {
        config["max_position_embeddings"] = json!(4096);
    });
    let model: Arc<dyn Mllm> = Arc::from(open_folder(copy.folder()));
    let about = model.describe();
    assert_eq!((about.image_size, about.image_tokens), (None, 0));
    for prompts in ["compact", "brief"] {
        let agent = plan_once(Arc::clone(&model), prompts);
        let call = agent.calls().first().unwrap();
        for attempt in &call.attempts {
            let rounds = &attempt.rounds;
            assert_eq!(rounds.len(), 3, "{prompts}");
            assert!(rounds.iter().all(|round| round.tokens.image == 0));
            assert!(!rounds[0].prompt.is_empty() && attempt.answer.is_some());
        }
    }
    let shown = PromptPrefix {
        system: String::new(),
        image: Some(RgbImage::new(8, 8).into()),
    };
    match model.converse(&shown, 0).map(|_| ()) {
        Err(MllmError::Image { problem }) => {
            assert!(problem.contains("text alone"), "{problem}");
        }
        other => panic!("{other:?}"),
    }
}

fn registry() -> ModelRegistry {
    ModelRegistry::new(
        "models",
        HubAccess {
            offline: true,
            ..HubAccess::default()
        },
    )
    .with_trust(Trust::Caller)
}

/// Opens a folder as `--model FOLDER` does.
fn open_folder(folder: &Path) -> Box<dyn Mllm> {
    let registry = registry();
    registry
        .open(&registry.find(folder.to_str().unwrap()).unwrap())
        .unwrap()
}

/// The prompt prefix of a checkpoint's reference chat.
fn prefix(folder: &Path) -> PromptPrefix {
    let image = ["image.png", "image_0.png"]
        .map(|name| folder.join(name))
        .into_iter()
        .find(|path| path.exists());
    let image = image::open(image.unwrap()).unwrap().into_rgb8();
    PromptPrefix {
        system: "Drive safely.".into(),
        image: Some(image.into()),
    }
}

/// Tokens of an answer that is compared.
const ANSWERED: usize = 12;

/// The text of a reference's first greedy tokens.
fn reference_answer(folder: &Path, name: &str) -> String {
    let tensors = candle_core::safetensors::load(
        folder.join("reference.safetensors"),
        &candle_core::Device::Cpu,
    )
    .unwrap();
    let ids = tensors[name]
        .flatten_all()
        .unwrap()
        .to_vec1::<i64>()
        .unwrap();
    let ids: Vec<u32> = ids
        .into_iter()
        .take(ANSWERED)
        .map(|id| u32::try_from(id).unwrap())
        .collect();
    tokenizers::Tokenizer::from_file(folder.join("tokenizer.json"))
        .unwrap()
        .decode(&ids, true)
        .unwrap()
}

#[test]
fn a_folder_is_opened_as_what_its_configuration_says_and_answers_as_the_reference() {
    for (Tiny { name, architecture }, folder) in families() {
        assert_eq!(
            Families::default().detect(&folder).unwrap().name(),
            *architecture
        );
        let model = open_folder(&folder);
        let about = model.describe();
        assert_eq!(about.architecture, *architecture);
        assert!(
            about.parameters > 50_000 && about.image_tokens > 0,
            "{about:?}"
        );
        let mut conversation = model.converse(&prefix(&folder), 0).unwrap();
        let answer = conversation.ask(FIRST, &free(ANSWERED)).unwrap();
        assert_eq!(
            answer.text,
            reference_answer(&folder, "generated"),
            "{name}"
        );
        assert!(
            answer.tokens.image > 0 && answer.tokens.image <= about.image_tokens,
            "{:?}",
            answer.tokens
        );
        if *name != "tiny_llava_next_mistral" {
            let mut conversation = model.converse(&prefix(&folder), 0).unwrap();
            conversation
                .ask(
                    FIRST,
                    &request(Constraint::Choice(vec!["keep left".into()]), 12),
                )
                .unwrap();
            let second = conversation.ask(SECOND, &free(ANSWERED)).unwrap();
            assert_eq!(
                second.text,
                reference_answer(&folder, "chat_generated"),
                "{name}"
            );
        }
    }
}

#[test]
fn rounds_and_rethinks_compute_the_image_once() {
    let code = r#"start: "Generate_IDM_Planner(c=" ("left" | "right") ", v0=" /[0-9]\.[0-9]/ ")""#;
    for (Tiny { name, architecture }, folder) in families() {
        let model = open_folder(&folder);
        let mut conversation = model.converse(&prefix(&folder), 7).unwrap();
        let start = conversation.mark();
        let mut whole = Vec::new();
        for attempt in 0..2 {
            let prompt = if attempt == 0 { "Look." } else { "Look again." };
            let first = conversation
                .ask(prompt, &request(Constraint::Regex("[a-f]{4}".into()), 8))
                .unwrap();
            if attempt == 0 {
                assert!(first.time.image_encode > 0.0 && first.tokens.image > 0);
                // The chat of a CogVLM begins with the image.
                assert_eq!(
                    first.tokens.cached == 0,
                    *architecture == "cogvlm",
                    "{:?}",
                    first.tokens
                );
            } else {
                assert!(first.time.image_encode.abs() < f64::EPSILON);
                assert_eq!(first.tokens.image, 0);
                assert!(
                    first.tokens.cached > whole[0],
                    "{:?}: the image stays computed",
                    first.tokens
                );
            }
            whole.push(first.tokens.image);
            let second = conversation
                .ask("Now?", &request(Constraint::Choice(vec!["keep".into()]), 8))
                .unwrap();
            assert_eq!(
                (
                    second.text.as_str(),
                    second.tokens.sampled,
                    second.tokens.image
                ),
                ("keep", 0, 0)
            );
            let third = conversation
                .ask("Code?", &request(Constraint::Lark(code.into()), 64))
                .unwrap();
            assert_eq!(third.finish, FinishReason::Complete, "{name}: {third:?}");
            assert!(third.text.starts_with("Generate_IDM_Planner(c=") && third.tokens.image == 0);
            assert!(
                third.tokens.fast_forwarded > third.tokens.sampled,
                "{:?}",
                third.tokens
            );
            conversation.rewind(start);
        }
    }
}

#[test]
fn a_rewound_round_is_answered_as_in_a_new_conversation() {
    for (Tiny { name, .. }, folder) in families() {
        let model = open_folder(&folder);
        let mut conversation = model.converse(&prefix(&folder), 0).unwrap();
        let start = conversation.mark();
        conversation.ask(SECOND, &free(6)).unwrap();
        conversation.rewind(start);
        let again = conversation.ask(FIRST, &free(ANSWERED)).unwrap();
        assert_eq!(again.text, reference_answer(&folder, "generated"), "{name}");
    }
}

#[test]
fn images_of_any_shape_are_taken_and_empty_ones_refused() {
    for (Tiny { name, .. }, folder) in families() {
        let model = open_folder(&folder);
        let most = model.describe().image_tokens;
        for (width, height) in [(336, 336), (90, 20), (3, 70), (1, 1)] {
            let image = RgbImage::from_fn(width, height, |x, y| image::Rgb([x as u8, y as u8, 99]));
            let prefix = PromptPrefix {
                system: String::new(),
                image: Some(image.into()),
            };
            let answer = model
                .converse(&prefix, 0)
                .unwrap()
                .ask("Go?", &free(2))
                .unwrap();
            assert!(
                answer.tokens.image > 0 && answer.tokens.image <= most,
                "{name}, {width} x {height}"
            );
        }
        let prefix = PromptPrefix {
            system: String::new(),
            image: Some(RgbImage::new(0, 0).into()),
        };
        let refused = model
            .converse(&prefix, 0)
            .and_then(|mut conversation| conversation.ask("Go?", &free(2)));
        assert!(
            matches!(refused, Err(MllmError::Image { .. })),
            "{name}: {refused:?}"
        );
    }
}

#[test]
fn an_image_takes_three_positions_of_cogvlm() {
    let copy = Copy::from_fixture("tiny_cogvlm");
    copy.edit("config.json", |config| {
        config["max_position_embeddings"] = json!(60);
    });
    let model = open_folder(copy.folder());
    assert_eq!(model.describe().context, 60);
    let mut conversation = model.converse(&prefix(copy.folder()), 0).unwrap();
    let answer = conversation
        .ask(FIRST, &request(Constraint::Regex("[ab]{900}".into()), 1000))
        .unwrap();
    assert_eq!(answer.finish, FinishReason::ContextFull);
    let tokens = answer.tokens;
    // The 18 image tokens share three positions, so 15 more than 60 fit.
    assert_eq!(
        tokens.text + tokens.image + tokens.cached + tokens.fast_forwarded + tokens.sampled,
        75,
        "{tokens:?}"
    );
    match conversation.ask(&"left ".repeat(40), &free(4)) {
        Err(MllmError::PromptTooLong {
            tokens,
            context: 75,
        }) => assert!(tokens > 75),
        other => panic!("{other:?}"),
    }
    let no_image = PromptPrefix {
        system: "Drive safely.".into(),
        image: None,
    };
    match model
        .converse(&no_image, 0)
        .unwrap()
        .ask(&"left ".repeat(60), &free(4))
    {
        Err(MllmError::PromptTooLong { context: 60, .. }) => {}
        other => panic!("{other:?}"),
    }
}

#[test]
fn cogvlm_without_an_image_keeps_its_system_prompt() {
    let model = open_folder(&fixture("tiny_cogvlm"));
    let prefix = PromptPrefix {
        system: "Drive safely.".into(),
        image: None,
    };
    let answer = model
        .converse(&prefix, 0)
        .unwrap()
        .ask(FIRST, &free(3))
        .unwrap();
    assert!(
        answer.tokens.cached > 5 && answer.tokens.image == 0,
        "{:?}",
        answer.tokens
    );
}

#[test]
fn a_tokenizer_may_lie_in_another_folder() {
    let copy = Copy::from_fixture("tiny_cogvlm");
    let expected = reference_answer(copy.folder(), "generated");
    let tokenizer = tempfile::tempdir().unwrap();
    std::fs::rename(
        copy.path("tokenizer.json"),
        tokenizer.path().join("tokenizer.json"),
    )
    .unwrap();
    let description = format!(
        "name = 'cog'\nsource = {{ folder = '{}' }}\ntokenizer = {{ folder = '{}' }}\nprompt_set = 'paper'\n",
        copy.folder().display(),
        tokenizer.path().display()
    );
    std::fs::write(copy.path("cog.toml"), description).unwrap();
    let model = open_folder(&copy.path("cog.toml"));
    let answer = model
        .converse(&prefix(copy.folder()), 0)
        .unwrap()
        .ask(FIRST, &free(ANSWERED))
        .unwrap();
    assert_eq!(answer.text, expected);
    // Without it, the error says what to do.
    assert!(
        copy.error().to_string().contains("copy it here"),
        "{}",
        copy.error()
    );
}

#[test]
fn a_description_of_another_architecture_is_refused() {
    let registry = registry();
    let mut spec = registry
        .find(fixture("tiny_llava_next").to_str().unwrap())
        .unwrap();
    spec.architecture = Architecture::named("cogvlm");
    match registry.open(&spec).map(|_| ()) {
        Err(MllmError::Config { key, problem, .. }) => {
            assert_eq!(key, "model_type");
            assert!(
                problem.contains("llava-next") && problem.contains("cogvlm"),
                "{problem}"
            );
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_described_models_are_all_readable() {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let registry = ModelRegistry::new(
        &models,
        HubAccess {
            offline: true,
            ..HubAccess::default()
        },
    );
    let names = registry.names().unwrap();
    for (name, architecture) in [
        ("llava-1.5-7b", "llava"),
        ("llava-1.5-13b", "llava"),
        ("llava-v1.6-vicuna-7b", "llava-next"),
        ("llava-v1.6-vicuna-13b", "llava-next"),
        ("llava-v1.6-mistral-7b", "llava-next"),
        ("cogvlm-chat-17b", "cogvlm"),
        ("smolvlm2-256m", "smolvlm"),
        ("smolvlm2-500m", "smolvlm"),
        ("smolvlm2-2.2b", "smolvlm"),
        ("internvl3-1b", "internvl"),
        ("internvl3-2b", "internvl"),
        ("qwen3-vl-2b", "qwen3-vl"),
        ("qwen3-vl-4b", "qwen3-vl"),
        ("qwen2.5-vl-3b", "qwen2.5-vl"),
        ("qwen2.5-vl-7b", "qwen2.5-vl"),
        ("qwen2-vl-2b", "qwen2-vl"),
        ("qwen2-vl-7b", "qwen2-vl"),
        ("llava-onevision-0.5b", "llava-onevision"),
        ("llava-onevision-7b", "llava-onevision"),
        ("gemma-3-4b", "gemma3"),
        ("gemma-3n-e2b", "gemma3n"),
        ("gemma-4-e2b", "gemma4"),
        ("gemma-4-e4b", "gemma4"),
        ("lfm2-vl-450m", "lfm2-vl"),
        ("lfm2.5-vl-450m", "lfm2-vl"),
        ("lfm2.5-vl-1.6b", "lfm2-vl"),
        ("qwen3.5-0.8b", "qwen3.5"),
        ("qwen3.5-2b", "qwen3.5"),
        ("qwen3.5-4b", "qwen3.5"),
    ] {
        assert!(names.iter().any(|known| known == name), "{names:?}");
        let spec = registry.find(name).unwrap();
        assert_eq!(
            (spec.name.as_str(), spec.architecture),
            (name, Architecture::named(architecture))
        );
        assert!(matches!(spec.source, ModelSource::Hub { .. }));
        assert_eq!(spec.tokenizer.is_some(), architecture == "cogvlm");
    }
}

/// Runs the beginning of a generated scene with one planning call.
fn plan_once(model: Arc<dyn Mllm>, prompts: &str) -> PlanAgent {
    let max_new_tokens = RoundTokens {
        understanding: 8,
        instruction: 64,
        code: 64,
    };
    let mut settings = PlanAgentSettings::default();
    (settings.agent.interval_s, settings.agent.blocked_interval_s) = (100.0, 100.0);
    settings.reflection = ReflectionSettings {
        threshold: 1.0,
        lane_change_threshold: 1.0,
        max_exec: 2,
        after_max_exec: AfterMaxExec::Last,
        monitoring: false,
        ..ReflectionSettings::default()
    };
    let reasoning = ReasoningSettings {
        rounds: Round::ALL.to_vec(),
        generation: GenerationSettings {
            max_new_tokens,
            sampling: Sampling::Greedy,
            ..GenerationSettings::default()
        },
        rethink_sampling: Sampling::Greedy,
        grammar: true,
        speculation: Speculation::History,
        proposals: Proposals::default(),
    };
    let code_source = CodeSource::Model {
        model,
        prompts: Arc::new(PromptSet::open(prompts).unwrap()),
        reasoning,
    };
    let mut agent = PlanAgent::new(PlannerName::PLAN_AGENT, code_source, settings);
    let scenario =
        generator::generate(&"generated/high_magnitude_speed/1".parse().unwrap()).unwrap();
    simulate(&scenario, &mut agent, Challenge::NonReactive).unwrap();
    agent
}

#[test]
fn the_agent_plans_with_every_family_and_nothing_else_changes() {
    for (Tiny { name, architecture }, folder) in families() {
        let copy = Copy::of_folder(&folder);
        // Random weights spell long answers in single bytes, so the chat needs more room than the
        // reference's.
        copy.edit("config.json", |config| {
            let text = if *architecture == "cogvlm" {
                config
            } else {
                &mut config["text_config"]
            };
            text["max_position_embeddings"] = json!(4096);
        });
        for prompts in ["compact", "brief"] {
            let agent = plan_once(Arc::from(open_folder(copy.folder())), prompts);
            let call = agent.calls().first().unwrap();
            assert!(!call.attempts.is_empty(), "{name}: {call:?}");
            for (index, attempt) in call.attempts.iter().enumerate() {
                let rounds = &attempt.rounds;
                assert_eq!(rounds.len(), 3, "{name}");
                assert!(attempt.answer.is_some(), "{name}: {}", rounds[2].answer);
                let image = rounds.iter().map(|round| round.tokens.image).sum::<usize>();
                assert_eq!(
                    image > 0,
                    index == 0,
                    "{name}: the image is computed once, {image}"
                );
            }
        }
    }
}
