//! What the child process does with the files: all that a model's start does but for the weights,
//! and texts of many kinds.

use super::TrialRequest;
use super::child::Line;
use crate::family::{Chat, ChatImage};
use crate::local::end_tokens;
use crate::source::Checkpoint;
use crate::text::{ChatTokenizer, GrammarEngine};
use crate::{Constraint, MllmError, Turn};
use std::io::{self, Write};

/// Repetitions of a word in a sample: a prompt with many agents has as many words.
const REPEATED: usize = 500;
/// Words that are repeated, as models do that are stuck. Patterns that try every split of a text
/// take long for them.
const WORDS: [&str; 12] = [
    "a",
    "x",
    "e ",
    "0",
    "the ",
    "  ",
    "\n",
    "=",
    "(",
    "\u{e9}",
    "\u{4eba}",
    "\u{1f6b2}",
];
/// Texts as prompts and answers have them.
const PHRASES: [&str; 3] = [
    "speed 9 limit 13 light red 24 turn straight ego free - - front vehicle1 14 7 left none - - rest 0",
    "why=lane_serves lat=keep why=free_road lon=accelerate",
    "Generate_IDM_Planner(c=ego_lane, la=vehicle1, v0=13.4, acc=1.5, dec=3.0)",
];
/// Characters of the longest run of one sample: all of the first blocks of Unicode, controls
/// included.
const CHARACTERS: u32 = 0x600;
/// Questions with their answers in the longest chat.
const MAX_TURNS: usize = 3;

/// Opens the small files of a model and the headers of its weights, and lets tokenizer, chat
/// template and grammars work. Writes to `out` what it begins with, and at the end whether the
/// files can be opened.
///
/// # Errors
/// When nothing can be written to `out`.
pub fn exercise(request: &TrialRequest, out: &mut dyn Write) -> io::Result<()> {
    let mut failed = None;
    let outcome = work(request, &mut |what| {
        let told = tell(out, &Line::Tries(what.to_owned()));
        failed = failed.take().or(told.err());
    });
    if let Some(error) = failed {
        return Err(error);
    }
    tell(
        out,
        &Line::Done(outcome.err().map(|error| error.to_string())),
    )
}

fn tell(out: &mut dyn Write, line: &Line) -> io::Result<()> {
    serde_json::to_writer(&mut *out, line)?;
    out.write_all(b"\n")?;
    out.flush()
}

fn work(request: &TrialRequest, begins: &mut dyn FnMut(&str)) -> Result<(), MllmError> {
    let Some((place, loading)) = request.place() else {
        return Ok(());
    };
    begins("the configuration");
    let mut checkpoint = Checkpoint::open(&place, None, &loading.families)?;
    checkpoint.weights.only_look();
    let mut model = checkpoint.open_model()?;
    model.set_images(loading.image)?;
    let info = model.info();
    let tokenizer_files = loading.tokenizer(&checkpoint.files, checkpoint.family)?;
    begins("the tokenizer");
    let tokenizer = ChatTokenizer::open(&tokenizer_files, info.vocabulary, info.image_token)?;
    for phrase in PHRASES {
        tokenizer.encode_text(phrase)?;
    }
    let texts = texts(&request.samples);
    for text in &texts {
        // An unusual text that a tokenizer or a template refuses is no fault of theirs: they must
        // come to an end.
        if let Ok(ids) = tokenizer.encode_text(text) {
            let _ = (tokenizer.decode(&ids), tokenizer.decode_verbatim(&ids));
        }
    }
    begins("the chat template");
    let format = model.chat_format(&checkpoint.files, &tokenizer)?;
    let image = model.drawn_layout().ok().flatten().map(ChatImage::first);
    let image: Vec<ChatImage> = image.into_iter().collect();
    let turns: Vec<Turn> = texts
        .iter()
        .rev()
        .map(|text| Turn {
            prompt: text.clone(),
            answer: text.clone(),
        })
        .take(MAX_TURNS)
        .collect();
    for (system, images) in [("", &[][..]), ("", &image), (PHRASES[0], &image)] {
        for prompt in &texts {
            let _ = format.ids(
                &tokenizer,
                &Chat {
                    system,
                    images,
                    turns: &[],
                    prompt,
                },
            );
        }
        for count in 1..=turns.len() {
            let turns = &turns[..count];
            let _ = format.ids(
                &tokenizer,
                &Chat {
                    system,
                    images,
                    turns,
                    prompt: PHRASES[1],
                },
            );
        }
    }
    begins("the grammars");
    let ends = end_tokens(&checkpoint.files, &tokenizer, info.vocabulary)?;
    let grammars = GrammarEngine::new(&tokenizer, &ends)?;
    let state = grammars.begin(&Constraint::Regex("[a-z0-9 =,.]{1,60}".to_owned()));
    let _ = state.map(|state| state.map(|mut state| state.allowed()));
    Ok(())
}

/// The texts that a trial reads, the shortest first.
fn texts(samples: &[String]) -> Vec<String> {
    let characters = (1..CHARACTERS).filter_map(char::from_u32).collect();
    let repeated = WORDS.iter().map(|word| word.repeat(REPEATED));
    let phrases = PHRASES.iter().map(ToString::to_string);
    let mut texts: Vec<String> = phrases
        .chain(samples.iter().cloned())
        .chain(repeated)
        .chain([characters])
        .collect();
    texts.sort_by_key(String::len);
    texts
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn said(folder: &Path) -> Vec<Line> {
        let request = serde_json::json!({"folder": folder, "samples": []});
        let mut out = Vec::new();
        exercise(&serde_json::from_value(request).unwrap(), &mut out).unwrap();
        out.split(|byte| *byte == b'\n')
            .filter(|line| !line.is_empty())
            .map(|line| serde_json::from_slice(line).unwrap())
            .collect()
    }

    #[test]
    fn a_model_is_tried_to_its_end_and_a_missing_file_is_named() {
        let nano = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/nano");
        let lines = said(&nano);
        assert_eq!(
            (lines.len(), lines.last()),
            (5, Some(&Line::Done(None))),
            "{lines:?}"
        );
        let folder = tempfile::tempdir().unwrap();
        match said(folder.path()).last() {
            Some(Line::Done(Some(problem))) => {
                assert!(problem.contains("config.json"), "{problem}");
            }
            other => panic!("{other:?}"),
        }
    }
}
