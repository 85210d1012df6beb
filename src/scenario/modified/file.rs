//! The TOML file of a modification.

use super::change::{Change as _, Head, PlacedChange};
use super::changes::Changes;
use super::error::ModifyError;
use super::fault::Fault;
use crate::interplan::InterPlanName;
use planagent_world::InteractionKind;
use std::path::Path;
use toml::Spanned;

/// A modification: what it is called, how its scenes are scored, and its changes.
#[derive(Debug)]
pub(super) struct Modification {
    /// Where it comes from, for errors.
    pub(super) place: String,
    /// What ids of its scenarios end in.
    pub(super) name: String,
    /// What numbers are drawn by, beside scenario and seeds: the name, unless two scenes share
    /// their draws.
    pub(super) drawn_by: String,
    /// interPlan's kind, which gives scenario type and score.
    pub(super) kind: Option<InteractionKind>,
    pub(super) seed: u64,
    /// In the order in which they apply.
    pub(super) changes: Vec<PlacedChange>,
}

impl Modification {
    /// Reads a file; its name without the ending is the name of the modification, unless it says
    /// another.
    pub(super) fn read(path: &Path) -> Result<Self, ModifyError> {
        let place = path.display().to_string();
        let text = planagent_files::read_text(path, planagent_files::MAX_SETTINGS_BYTES).map_err(
            |source| ModifyError::Read {
                place: place.clone(),
                source,
            },
        )?;
        let stem = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        Self::parse(&place, &stem, &text)
    }

    /// A scene that interPlan names.
    pub(super) fn of_scene(name: &InterPlanName) -> Result<Self, ModifyError> {
        let place = format!("interPlan's {name}");
        let refused = |fault| ModifyError::Head {
            place: place.clone(),
            fault,
        };
        name.check().map_err(refused)?;
        let change = PlacedChange {
            key: "interplan",
            line: 1,
            change: Box::new(name.clone()),
        };
        let (name, kind) = (name.to_string(), name.kind());
        Ok(Self {
            place,
            drawn_by: name.clone(),
            name,
            kind,
            seed: 0,
            changes: vec![change],
        })
    }

    /// Parses the text of a file.
    pub(super) fn parse(place: &str, stem: &str, text: &str) -> Result<Self, ModifyError> {
        let parsed: Result<(Head, Changes), _> = Changes::parse(text);
        let (head, changes) = parsed.map_err(|source| ModifyError::Parse {
            place: place.to_owned(),
            source: Box::new(source),
        })?;
        let line_of = |byte: usize| {
            text.bytes()
                .take(byte)
                .filter(|&byte| byte == b'\n')
                .count()
                + 1
        };
        let refused = |word: Option<&Spanned<String>>, fault| ModifyError::Head {
            place: word.map_or_else(
                || place.to_owned(),
                |word| format!("{place}, line {}", line_of(word.span().start)),
            ),
            fault,
        };
        // The name becomes part of a scenario's word and of file names, which allow these letters
        // only.
        let name = head
            .name
            .as_ref()
            .map_or_else(|| stem.to_owned(), |name| name.get_ref().clone());
        let fits = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if name.is_empty() || !name.chars().all(fits) {
            let text = format!(
                "{name:?} must be a word of the letters a to z, digits, '-', '_' and '.'; it is that of the file unless \
                                the file has a key name"
            );
            return Err(refused(head.name.as_ref(), Fault::new("name", text)));
        }
        let kind = match head.kind {
            None => None,
            Some(word) => Some(InteractionKind::named(word.get_ref()).ok_or_else(|| {
                let known = InteractionKind::ALL.map(InteractionKind::name).join(", ");
                let text = format!("{:?} is none of {known}", word.get_ref());
                refused(Some(&word), Fault::new("kind", text))
            })?),
        };
        let changes = changes.placed(line_of);
        for PlacedChange { key, line, change } in &changes {
            change.check().map_err(|fault| ModifyError::Value {
                place: place.to_owned(),
                line: *line,
                key,
                fault,
            })?;
        }
        Ok(Self {
            place: place.to_owned(),
            drawn_by: name.clone(),
            name,
            kind,
            seed: head.seed,
            changes,
        })
    }
}
