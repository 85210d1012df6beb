//! A dataset as chat messages, for trainers of others: conversations of all rounds, lessons,
//! preferences and tried codes, each as JSON lines, with the pictures as PNG files beside.
//!
//! The states are those of the labeled states with the same settings. A shard is a file in each of
//! `codes/SPLIT`, `preferences/SPLIT`, `lessons/SPLIT`, that of each other agent, and
//! `messages/SPLIT`. The last is written last, so that its presence shows completeness. Columns have
//! one type in all lines, so that a table can be read line by line. `docs/teach.md` describes them.

mod answers;
mod card;
mod images;
mod rows;

use super::shard::{self, ShardError, write_file};
use super::{DatasetError, Settings, Split, Teacher, scenes, states};
use planagent_agent::environment::bev::Palette;
use planagent_agent::reasoning::PromptError;
use rayon::prelude::*;
use rows::Rows;
use serde::Serialize;
use std::fs;
use std::path::{Path, PathBuf};

/// Version of the layout.
const FORMAT: u32 = 2;
/// The files of a shard beside its conversations.
const BESIDE: [&str; 3] = ["codes", "preferences", "lessons"];
/// The one that shows that a shard is complete.
const CONVERSATIONS: &str = "messages";

/// The model that the messages are for.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MessageModel {
    /// Its name, as `--model` takes it.
    pub name: String,
    /// Side of its picture, pixels; none for a model that reads text alone.
    pub image_pixels: Option<u32>,
    /// Tokens of its picture, where they are known.
    pub image_tokens: Option<usize>,
}

impl MessageModel {
    /// The meaning of the picture's colors, for the system prompt; empty without a picture.
    fn legend(&self) -> String {
        self.image_pixels
            .map_or_else(String::new, |_| Palette::legend())
    }
}

/// Which chats are written.
#[derive(Clone, Copy)]
pub struct Chats<'a> {
    /// The model that PlanAgent's are for.
    pub model: &'a MessageModel,
    /// Those of other agents.
    pub teachers: &'a [Teacher],
}

/// `meta.json`.
#[derive(Debug, Serialize)]
struct Meta<'a> {
    format: u32,
    kind: &'static str,
    model: &'a MessageModel,
    /// Side of the area that a picture shows, meters.
    view_m: f64,
    prompt_set: &'a str,
    /// BLAKE3 of the files of the prompt set.
    prompts_blake3: &'a str,
    /// Other agents whose conversations stand beside.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    agents: Vec<&'static str>,
    /// Share of modified scenarios.
    modified: f64,
    seed: u64,
    planagent: &'static str,
}

fn meta<'a>(settings: &'a Settings<'_>, chats: Chats<'a>) -> Meta<'a> {
    Meta {
        format: FORMAT,
        kind: CONVERSATIONS,
        model: chats.model,
        view_m: settings.view.meters(),
        prompt_set: settings.prompts.name(),
        prompts_blake3: settings.prompts.blake3(),
        agents: chats.teachers.iter().map(Teacher::name).collect(),
        modified: settings.modified,
        seed: settings.seed,
        planagent: env!("CARGO_PKG_VERSION"),
    }
}

/// Checks that a dataset of messages with these settings can be begun or resumed in a folder, and
/// writes nothing.
///
/// # Errors
/// When it holds other files, or a dataset with other settings.
pub fn check_messages(
    folder: &Path,
    settings: &Settings<'_>,
    chats: Chats<'_>,
) -> Result<(), DatasetError> {
    shard::is_begun(folder, &meta(settings, chats))?;
    Ok(())
}

/// Writes shards until a split has `states` conversations. Complete shards of an earlier run stay.
/// Gives the number of conversations; `on_states` gets that of each shard.
pub fn write_messages(
    folder: &Path,
    split: Split,
    states: usize,
    settings: &Settings<'_>,
    chats: Chats<'_>,
    on_states: &dyn Fn(usize),
) -> Result<usize, DatasetError> {
    shard::open_folder(folder, &meta(settings, chats))?;
    let (mut count, mut number) = (0, 0);
    while count < states {
        let made = match complete(folder, split, number) {
            Some(present) => present,
            None => write_shard(folder, split, number, settings, chats)?,
        };
        on_states(made);
        count += made;
        number += 1;
    }
    Ok(count)
}

/// Writes the data card and LLaMA-Factory's list of the files, from all complete shards.
pub fn write_message_card(
    folder: &Path,
    settings: &Settings<'_>,
    chats: Chats<'_>,
) -> Result<(), DatasetError> {
    let card = card::Card::read(folder, settings, chats)?;
    write_file(&folder.join("README.md"), card.markdown().as_bytes())?;
    let listed = serde_json::to_string_pretty(&card.dataset_info()).map_err(ShardError::from)?;
    write_file(
        &folder.join("dataset_info.json"),
        format!("{listed}\n").as_bytes(),
    )?;
    Ok(())
}

/// A file of a shard.
fn path(folder: &Path, file: &str, split: Split, number: usize) -> PathBuf {
    folder.join(format!("{file}/{}/{number:05}.jsonl", split.as_str()))
}

/// Number of conversations of a complete shard.
fn complete(folder: &Path, split: Split, number: usize) -> Option<usize> {
    let text = fs::read_to_string(path(folder, CONVERSATIONS, split, number)).ok()?;
    Some(text.lines().count())
}

/// Writes a shard, and gives the number of its conversations.
fn write_shard(
    folder: &Path,
    split: Split,
    number: usize,
    settings: &Settings<'_>,
    chats: Chats<'_>,
) -> Result<usize, DatasetError> {
    let scenarios = scenes::scenarios(split, number, settings)?;
    let made = scenarios.par_iter().map(|spec| {
        states::walk(spec, settings, &|visited, feedback| {
            Rows::of_state(visited, feedback.as_ref(), settings, chats)
        })
    });
    let mut made: Vec<Rows> = made
        .collect::<Result<Vec<_>, PromptError>>()?
        .into_iter()
        .flatten()
        .collect();
    if chats.model.image_pixels.is_some() {
        images::create_folder(folder, split.as_str(), number)?;
    }
    for (row, rows) in made.iter_mut().enumerate() {
        if let Some(image) = rows.image.take() {
            let path = images::path(split.as_str(), number, row);
            images::write(folder, &path, &image)?;
            rows.show(&path);
        }
    }
    let [codes, preferences, lessons] = BESIDE;
    let mut files = vec![
        (codes, lines(made.iter().flat_map(|rows| &rows.codes))?),
        (
            preferences,
            lines(made.iter().flat_map(|rows| &rows.preferences))?,
        ),
        (lessons, lines(made.iter().flat_map(|rows| &rows.lessons))?),
    ];
    for (index, teacher) in chats.teachers.iter().enumerate() {
        let of_agent = made
            .iter()
            .filter_map(|rows| rows.agents.get(index)?.as_ref());
        files.push((teacher.name(), lines(of_agent)?));
    }
    // The file that shows completeness comes last.
    let conversations = made.iter().map(|rows| &rows.conversation);
    files.push((CONVERSATIONS, lines(conversations)?));
    for (file, lines) in files {
        let path = path(folder, file, split, number);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(|source| ShardError::Write {
                path: parent.to_owned(),
                source,
            })?;
        }
        write_file(&path, lines.as_bytes())?;
    }
    Ok(made.len())
}

fn lines<'a, T: Serialize + 'a>(rows: impl Iterator<Item = &'a T>) -> Result<String, ShardError> {
    let mut text = String::new();
    for row in rows {
        text.push_str(&serde_json::to_string(row)?);
        text.push('\n');
    }
    Ok(text)
}
