//! Conversations: rounds, marks, seeds, counts.

use super::{FIRST, SECOND, free, open, prefix, request, tiny};
use planagent_mllm::{
    Constraint, FinishReason, Mllm, MllmError, PromptPrefix, Sampling, prompt_hash,
};

/// The greedy answer that transformers gives in the reference.
fn reference_answer(name: &str) -> String {
    let tensors = candle_core::safetensors::load(
        tiny().join("reference.safetensors"),
        &candle_core::Device::Cpu,
    )
    .unwrap();
    let ids: Vec<u32> = tensors[name]
        .to_vec1::<i64>()
        .unwrap()
        .into_iter()
        .map(|id| u32::try_from(id).unwrap())
        .collect();
    tokenizers::Tokenizer::from_file(tiny().join("tokenizer.json"))
        .unwrap()
        .decode(&ids, true)
        .unwrap()
}

#[test]
fn both_rounds_are_answered_as_transformers_answers_them() {
    let model = open();
    let mut conversation = model.converse(&prefix(), 0).unwrap();
    let start = conversation.mark();
    let first = conversation.ask(FIRST, &free(12)).unwrap();
    assert_eq!(first.text, reference_answer("generated"));
    assert_eq!(first.finish, FinishReason::Length);
    assert_eq!(first.prompt_hash, prompt_hash("Drive safely.", &[], FIRST));
    let tokens = first.tokens;
    assert_eq!(tokens.text + tokens.image + tokens.cached, 45, "{tokens:?}");
    assert_eq!(
        (tokens.image, tokens.fast_forwarded, tokens.sampled),
        (16, 0, 12)
    );
    assert!(tokens.cached > 0, "the system prompt is known");
    assert!(first.time.image_encode > 0.0 && first.time.prefill > 0.0 && first.time.decode > 0.0);
    assert!(
        first.time.first_token >= first.time.prefill && first.time.total >= first.time.first_token
    );

    // The reference chat continues after the answer "keep left".
    conversation.rewind(start);
    let chosen = conversation
        .ask(
            FIRST,
            &request(Constraint::Choice(vec!["keep left".into()]), 12),
        )
        .unwrap();
    assert_eq!(
        (chosen.text.as_str(), chosen.tokens.sampled),
        ("keep left", 0)
    );
    let second = conversation.ask(SECOND, &free(12)).unwrap();
    assert_eq!(second.text, reference_answer("chat_generated"));
    assert_eq!(second.tokens.image, 0, "the image stays computed");
    assert!(second.time.image_encode.abs() < f64::EPSILON);
    assert!(second.tokens.cached >= 44, "{:?}", second.tokens);
}

#[test]
fn a_rewound_round_is_answered_as_the_first_time() {
    let model = open();
    let mut conversation = model.converse(&prefix(), 3).unwrap();
    conversation.ask(FIRST, &free(5)).unwrap();
    let mark = conversation.mark();
    let once = conversation.ask(SECOND, &free(20)).unwrap();
    conversation.ask("And then?", &free(5)).unwrap();
    conversation.rewind(mark);
    let again = conversation.ask(SECOND, &free(20)).unwrap();
    assert_eq!(
        (&once.text, &once.prompt_hash),
        (&again.text, &again.prompt_hash)
    );
    assert!(
        again.tokens.cached > once.tokens.cached,
        "{:?} {:?}",
        once.tokens,
        again.tokens
    );
    assert_eq!(
        again.tokens.text, 1,
        "only the last token of the prompt is computed again"
    );
}

#[test]
fn the_system_prompt_is_computed_once_a_run_and_changes_nothing() {
    let model = open();
    let answers = |model: &dyn Mllm| {
        let mut conversation = model.converse(&prefix(), 1).unwrap();
        conversation.ask(FIRST, &free(16)).unwrap()
    };
    let (first, second) = (answers(&model), answers(&model));
    assert_eq!((&first.text, first.tokens), (&second.text, second.tokens));
    let fresh = open();
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(|| answers(&fresh))).collect();
        for thread in threads {
            let answer = thread.join().unwrap();
            assert_eq!((&answer.text, answer.tokens), (&first.text, first.tokens));
        }
    });
}

#[test]
fn sampling_follows_the_seed() {
    let model = open();
    let sampled = |seed| {
        let mut request = free(24);
        request.sampling = Sampling::Sample {
            temperature: 1.5,
            top_p: 0.95,
        };
        let mut conversation = model.converse(&prefix(), seed).unwrap();
        let mark = conversation.mark();
        let first = conversation.ask(FIRST, &request).unwrap().text;
        conversation.rewind(mark);
        (first, conversation.ask(FIRST, &request).unwrap().text)
    };
    let (first, retry) = sampled(11);
    assert_eq!((first.clone(), retry.clone()), sampled(11));
    assert_ne!(first, retry, "another attempt samples other tokens");
    assert_ne!(first, sampled(12).0);
}

#[test]
fn without_an_image_or_system_prompt_the_template_leaves_them_out() {
    let model = open();
    let mut conversation = model.converse(&PromptPrefix::default(), 0).unwrap();
    let answer = conversation.ask(FIRST, &free(4)).unwrap();
    assert_eq!(answer.tokens.image, 0);
    assert!(answer.tokens.text + answer.tokens.cached < 30);
}

#[test]
fn a_placeholder_in_the_text_is_refused_and_leaves_the_chat_as_it_was() {
    let model = open();
    let mut conversation = model.converse(&prefix(), 0).unwrap();
    let before = conversation.mark();
    match conversation.ask("Look: <image>", &free(4)) {
        Err(MllmError::ImagePlaceholder {
            expected: 1,
            found: 2,
        }) => {}
        other => panic!("{other:?}"),
    }
    assert_eq!(conversation.mark(), before);
    assert_eq!(
        conversation.ask(FIRST, &free(12)).unwrap().text,
        reference_answer("generated")
    );
}

#[test]
fn a_prompt_beyond_the_context_is_refused_and_an_answer_ends_at_it() {
    let model = open();
    let context = model.describe().context;
    let mut conversation = model.converse(&prefix(), 0).unwrap();
    match conversation.ask(&"left ".repeat(context), &free(4)) {
        Err(MllmError::PromptTooLong {
            tokens,
            context: 256,
        }) => assert!(tokens > context),
        other => panic!("{other:?}"),
    }
    let long = "0 ".repeat(90);
    let answer = conversation
        .ask(&long, &request(Constraint::Regex("[ab]*".into()), 1000))
        .unwrap();
    assert_eq!(answer.finish, FinishReason::ContextFull);
    let tokens = answer.tokens;
    assert_eq!(
        tokens.text + tokens.image + tokens.cached + tokens.fast_forwarded + tokens.sampled,
        context
    );
    assert!(matches!(
        model.converse(
            &PromptPrefix {
                system: "x ".repeat(400),
                image: None
            },
            0
        ),
        Err(MllmError::PromptTooLong { .. })
    ));
}

#[test]
fn the_description_says_what_the_model_is() {
    let description = open().describe();
    assert_eq!(description.image_size, Some(32));
    assert_eq!(
        (
            description.image_tokens,
            description.vocabulary,
            description.context
        ),
        (16, 352, 256)
    );
    let weights = std::fs::read(tiny().join("model.safetensors")).unwrap();
    assert_eq!(
        description.weights_blake3,
        blake3::hash(&weights).to_hex().to_string()
    );
    // All tensors but the tower's last norm, which a LLaVA does not use.
    let tensors = safetensors::SafeTensors::deserialize(&weights).unwrap();
    let elements: usize = tensors
        .iter()
        .map(|(_, view)| view.shape().iter().product::<usize>())
        .sum();
    assert_eq!(description.parameters, elements as u64 - 64);
}
