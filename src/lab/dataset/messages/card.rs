//! The data card of a dataset of messages, and LLaMA-Factory's list of its files.

use super::{BESIDE, CONVERSATIONS, Chats, DatasetError, MessageModel, complete, path};
use crate::dataset::shard::ShardError;
use crate::dataset::{Settings, Split, Teacher};
use crate::tokens::TokenCounter;
use rayon::prelude::*;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// License of the scenes and of all that is computed from them.
const LICENSE: &str = "Apache-2.0";
/// Splits of a dataset.
const SPLITS: [Split; 2] = [Split::Train, Split::Validation];

/// What is counted of a line.
#[derive(Deserialize)]
struct Line {
    messages: Vec<Said>,
}

#[derive(Deserialize)]
struct Said {
    content: String,
}

/// What is counted of a split.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Counted {
    split: Split,
    conversations: usize,
    preferences: usize,
    codes: usize,
    /// Text tokens of all conversations by `cl100k_base`, and of the longest.
    tokens: (usize, usize),
}

/// What the card says.
pub(super) struct Card<'a> {
    settings: &'a Settings<'a>,
    model: &'a MessageModel,
    /// Other agents whose conversations stand beside.
    agents: Vec<&'static str>,
    splits: Vec<Counted>,
}

impl<'a> Card<'a> {
    /// Counts all complete shards.
    pub(super) fn read(
        folder: &Path,
        settings: &'a Settings<'a>,
        Chats { model, teachers }: Chats<'a>,
    ) -> Result<Self, DatasetError> {
        let splits = SPLITS
            .into_iter()
            .map(|split| Counted::read(folder, split))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            settings,
            model,
            agents: teachers.iter().map(Teacher::name).collect(),
            splits: splits
                .into_iter()
                .filter(|counted| counted.conversations > 0)
                .collect(),
        })
    }

    /// The card as the hub reads it: settings of the loader first, then text.
    pub(super) fn markdown(&self) -> String {
        let mut text = format!("---\nlicense: {}\nconfigs:\n", LICENSE.to_lowercase());
        // Writing to a text cannot fail.
        let files = [CONVERSATIONS].into_iter();
        for file in files
            .chain(self.agents.iter().copied())
            .chain(BESIDE.into_iter().rev())
        {
            let _ = writeln!(text, "- config_name: {file}\n  data_files:");
            for Counted { split, .. } in &self.splits {
                let split = split.as_str();
                let _ = writeln!(text, "  - split: {split}\n    path: {file}/{split}/*.jsonl");
            }
        }
        text.push_str("---\n\n# Planning calls as chat messages\n\n");
        text.push_str(
            "Made by `planagent dataset --for messages`. A line is a state of a generated scene. \
             The answers are those of a search that simulates planner codes for six seconds.\n\n\
             No recording is in it: map, traffic and pictures come from the program's generator \
             alone.\n\n",
        );
        text.push_str("| | |\n|---|---|\n");
        for (key, value) in self.facts() {
            let _ = writeln!(text, "| {key} | {value} |");
        }
        text.push_str(
            "\n| split | seeds | conversations | preferences | tried codes | text tokens, mean | \
             most |\n|---|---|---|---|---|---|---|\n",
        );
        for counted in &self.splits {
            let _ = writeln!(text, "{}", counted.row());
        }
        text.push_str(
            "\nText tokens are counted by `cl100k_base`, without a chat template and without the \
             picture. Scenes of different splits have different seeds.\n",
        );
        text
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        // A server does not say how many tokens a picture becomes.
        let (model, settings) = (self.model, self.settings);
        let picture = match model.image_pixels {
            Some(pixels) => format!(
                "{pixels} x {pixels} pixels, {} m a side",
                settings.view.meters()
            ),
            None => "none: the model reads text alone".to_owned(),
        };
        let tokens = match (model.image_pixels, model.image_tokens) {
            (None, _) => "0".to_owned(),
            (Some(_), Some(tokens)) => tokens.to_string(),
            (Some(_), None) => "unknown".to_owned(),
        };
        vec![
            ("license", LICENSE.to_owned()),
            ("model", model.name.clone()),
            (
                "prompt set",
                format!(
                    "{} (BLAKE3 {})",
                    settings.prompts.name(),
                    settings.prompts.blake3()
                ),
            ),
            ("picture", picture),
            ("tokens of the picture", tokens),
            ("seed", settings.seed.to_string()),
            ("share of modified scenes", settings.modified.to_string()),
            ("PlanAgent", env!("CARGO_PKG_VERSION").to_owned()),
        ]
    }

    /// `dataset_info.json` of LLaMA-Factory.
    pub(super) fn dataset_info(&self) -> Value {
        let tags = json!({
            "role_tag": "role", "content_tag": "content", "user_tag": "user",
            "assistant_tag": "assistant", "system_tag": "system",
        });
        let entry = |file: &str, split: &str, columns: Value, ranking: bool| {
            // A column of pictures that is not there would be an error.
            let mut columns = columns;
            if let (Some(_), Some(columns)) = (self.model.image_pixels, columns.as_object_mut()) {
                columns.insert("images".to_owned(), json!("images"));
            }
            json!({
                "file_name": format!("{file}/{split}"), "formatting": "sharegpt",
                "ranking": ranking, "columns": columns, "tags": tags,
            })
        };
        let mut listed = Map::new();
        for Counted { split, .. } in &self.splits {
            let split = split.as_str();
            let messages = json!({"messages": "messages"});
            for agent in &self.agents {
                listed.insert(
                    format!("planagent_{agent}_{split}"),
                    // These agents see no picture.
                    json!({
                        "file_name": format!("{agent}/{split}"), "formatting": "sharegpt",
                        "columns": messages, "tags": tags,
                    }),
                );
            }
            let preferences = json!({
                "messages": "prompt", "chosen": "chosen_message", "rejected": "rejected_message",
            });
            listed.insert(
                format!("planagent_{split}"),
                entry(CONVERSATIONS, split, messages, false),
            );
            listed.insert(
                format!("planagent_preferences_{split}"),
                entry("preferences", split, preferences, true),
            );
        }
        Value::Object(listed)
    }
}

impl Counted {
    fn read(folder: &Path, split: Split) -> Result<Self, DatasetError> {
        // Shards are written in order, so that the first gap is the end.
        let numbers = (0..).take_while(|&number| complete(folder, split, number).is_some());
        let numbers: Vec<usize> = numbers.collect();
        let text = |file: &str, number: usize| {
            let path = path(folder, file, split, number);
            fs::read_to_string(&path).map_err(|source| ShardError::Read { path, source })
        };
        let of_shard = |&number: &usize| -> Result<Self, ShardError> {
            let counter = TokenCounter::new(None);
            let mut tokens = (0, 0);
            let conversations = text(CONVERSATIONS, number)?;
            for line in conversations.lines() {
                let line: Line = serde_json::from_str(line)?;
                let said = line.messages.iter();
                let count: usize = said.map(|said| counter.count(&said.content).cl100k).sum();
                tokens = (tokens.0 + count, count.max(tokens.1));
            }
            Ok(Self {
                split,
                conversations: conversations.lines().count(),
                preferences: text("preferences", number)?.lines().count(),
                codes: text("codes", number)?.lines().count(),
                tokens,
            })
        };
        let shards: Vec<Self> = numbers
            .par_iter()
            .map(of_shard)
            .collect::<Result<_, ShardError>>()?;
        let none = Self {
            split,
            conversations: 0,
            preferences: 0,
            codes: 0,
            tokens: (0, 0),
        };
        Ok(shards.into_iter().fold(none, |all, one| Self {
            split,
            conversations: all.conversations + one.conversations,
            preferences: all.preferences + one.preferences,
            codes: all.codes + one.codes,
            tokens: (all.tokens.0 + one.tokens.0, all.tokens.1.max(one.tokens.1)),
        }))
    }

    fn row(&self) -> String {
        let seeds = self.split.seeds();
        format!(
            "| {} | {} to {} | {} | {} | {} | {:.0} | {} |",
            self.split.as_str(),
            seeds.start,
            seeds.end - 1,
            self.conversations,
            self.preferences,
            self.codes,
            self.tokens.0 as f64 / self.conversations.max(1) as f64,
            self.tokens.1
        )
    }
}
