//! Prompt sets: folders of templates with a `set.toml`. Four of them are built in.

use super::error::PromptError;
use super::known_variables;
use super::prompt_source::{PromptFiles, PromptPlace};
use super::round::Round;
use super::templates::Templates;
use crate::environment::facts::Question;
use crate::environment::text::TextForm;
use minijinja::Value;
use serde::Deserialize;
use std::collections::BTreeMap;

/// The file with the forms.
const SETTINGS: &str = "set.toml";
/// The files of a set.
const FILES: [&str; 6] = [
    SETTINGS,
    "system.jinja",
    "understanding.jinja",
    "instruction.jinja",
    "code.jinja",
    "feedback.jinja",
];
/// Sets of a question outside the rounds, with their files.
const QUESTION_SETS: [&str; 3] = ["llm_assist_unc", "llm_assist_par", "ask"];
const QUESTION_FILES: [&str; 2] = ["system.jinja", "question.jinja"];

/// The form of answers in round 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum UnderstandingForm {
    /// In sentences.
    Free,
    /// Four words after fixed keys, and a short note, under a grammar.
    Short,
    /// `key=value` for each question of the first version, under a grammar.
    Choices,
    /// `key=value` for each question, under a grammar.
    #[serde(rename = "choices-2")]
    Choices2,
}

impl UnderstandingForm {
    /// The questions that are answered by `key=value`.
    pub fn questions(self) -> &'static [Question] {
        match self {
            Self::Free | Self::Short => &[],
            Self::Choices => Question::first_version(),
            Self::Choices2 => Question::ALL,
        }
    }
}

/// The form of answers in round 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum InstructionForm {
    /// Two lines with a reason in free text, under a grammar.
    Reasoned,
    /// Two words after fixed keys, and a short reason, under a grammar.
    Short,
    /// `key=value`, under a grammar.
    Choices,
}

/// Bounds on answers that a set asks for, tokens; the model's own bounds hold too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, serde::Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct AnswerLimits {
    /// Round 1.
    pub understanding: Option<usize>,
    /// Round 2.
    pub instruction: Option<usize>,
}

/// `set.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields)]
pub struct PromptForms {
    /// Form of the lane-graph text.
    pub scene_text: TextForm,
    pub understanding: UnderstandingForm,
    pub instruction: InstructionForm,
    #[serde(default)]
    pub max_tokens: AnswerLimits,
}

impl PromptForms {
    /// The bound on a round's answer for a model whose own is `of_model`, tokens.
    pub(super) fn max_tokens(&self, round: Round, of_model: usize) -> usize {
        let of_set = match round {
            Round::Understanding => self.max_tokens.understanding,
            Round::Instruction => self.max_tokens.instruction,
            Round::Code => None,
        };
        of_set.map_or(of_model, |limit| limit.min(of_model))
    }
}

/// A set of prompts: its forms and its compiled templates, and beside them those of LLM-ASSIST's
/// questions.
#[derive(Debug)]
pub struct PromptSet {
    forms: PromptForms,
    templates: Templates,
    questions: Vec<Templates>,
    place: PromptPlace,
    is_built_in: bool,
    blake3: String,
    digests: BTreeMap<String, String>,
}

impl PromptSet {
    /// The set of a name, or the set in a folder. `prompts/NAME`, in the working directory or where
    /// `PLANAGENT_PROMPTS` says, overrides the built-in set NAME.
    pub fn open(name_or_folder: &str) -> Result<Self, PromptError> {
        let files = PromptFiles::find(name_or_folder, &FILES)?;
        let questions = QUESTION_SETS.map(|set| PromptFiles::find(set, &QUESTION_FILES));
        Self::compile(
            &files,
            &questions.into_iter().collect::<Result<Vec<_>, _>>()?,
        )
    }

    fn compile(files: &PromptFiles, questions: &[PromptFiles]) -> Result<Self, PromptError> {
        let forms =
            toml::from_str(files.text(SETTINGS)).map_err(|source| PromptError::Settings {
                path: files.path(SETTINGS),
                source: Box::new(source),
            })?;
        let mut hasher = blake3::Hasher::new();
        let all = || std::iter::once(files).chain(questions);
        all().for_each(|files| files.hash(&mut hasher));
        let compile = |files: &PromptFiles, set: Option<&str>| {
            Templates::compile(&files.name, files.templates(), |template| {
                Some(set.map_or_else(
                    || known_variables::of_template(template),
                    |set| known_variables::of_question(set, template),
                ))
            })
        };
        let questions = questions.iter().zip(QUESTION_SETS);
        Ok(Self {
            forms,
            templates: compile(files, None)?,
            questions: questions
                .map(|(files, set)| compile(files, Some(set)))
                .collect::<Result<_, _>>()?,
            place: files.place.clone(),
            is_built_in: all().all(PromptFiles::is_built_in),
            blake3: hasher.finalize().to_hex().to_string(),
            digests: all().flat_map(PromptFiles::digests).collect(),
        })
    }

    /// Where its templates are.
    pub fn place(&self) -> &PromptPlace {
        &self.place
    }

    /// Whether all templates are those of the program.
    pub fn is_built_in(&self) -> bool {
        self.is_built_in
    }

    /// BLAKE3 of its files, hexadecimal.
    pub fn blake3(&self) -> &str {
        &self.blake3
    }

    /// BLAKE3 of each of its files, hexadecimal, by set and name.
    pub fn digests(&self) -> &BTreeMap<String, String> {
        &self.digests
    }

    /// The templates of a question outside the rounds.
    pub(super) fn question_set(&self, name: &'static str) -> Result<&Templates, PromptError> {
        let found = self
            .questions
            .iter()
            .find(|templates| templates.set() == name);
        found.ok_or_else(|| PromptError::Unknown {
            name: name.to_owned(),
            known: Vec::new(),
        })
    }

    /// The name or folder that it was opened by.
    pub fn name(&self) -> &str {
        self.templates.set()
    }

    pub fn forms(&self) -> &PromptForms {
        &self.forms
    }

    pub(super) fn system(&self, context: Value) -> Result<String, PromptError> {
        self.templates.render("system", context)
    }

    pub(super) fn round(&self, round: Round, context: Value) -> Result<String, PromptError> {
        self.templates.render(round.as_str(), context)
    }

    pub(super) fn feedback(&self, context: Value) -> Result<String, PromptError> {
        self.templates.render("feedback", context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn built_in_sets_compile() {
        for name in ["paper", "brief", "compact", "compact-2"] {
            let set = PromptSet::open(name).unwrap();
            assert_eq!((set.name(), set.is_built_in()), (name, true));
        }
    }

    #[test]
    fn without_a_picture_no_prompt_speaks_of_one() {
        for name in ["paper", "brief", "compact", "compact-2"] {
            let set = PromptSet::open(name).unwrap();
            let system = |legend| set.system(super::super::variables::system(legend)).unwrap();
            let (with, without) = (system("Colours: none."), system(""));
            assert!(!without.contains("picture"), "{name}: {without}");
            assert!(!without.contains("\n\n\n"), "{without}");
            let long = ["paper", "brief"].contains(&name);
            assert_eq!(with.contains("picture"), long, "{name}: {with}");
            assert_eq!(with.contains("Colours: none."), long);
        }
    }

    #[test]
    fn a_set_may_bound_answers() {
        let brief = *PromptSet::open("brief").unwrap().forms();
        let limits = Round::ALL
            .iter()
            .map(|&round| brief.max_tokens(round, 320))
            .collect::<Vec<_>>();
        assert!(
            limits[0] < 50 && limits[1] < 50 && limits[2] == 320,
            "{limits:?}"
        );
        assert_eq!(brief.max_tokens(Round::Understanding, 8), 8);
        let paper = *PromptSet::open("paper").unwrap().forms();
        assert_eq!(paper.max_tokens(Round::Instruction, 320), 320);
    }

    #[test]
    fn wrong_sets_say_what_is_wrong() {
        assert!(matches!(
            PromptSet::open("nowhere"),
            Err(PromptError::Unknown { .. })
        ));
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(
            folder.path().join(SETTINGS),
            "scene_text = 'compact'\nunderstandng = 'free'",
        )
        .unwrap();
        let missing = PromptSet::open(folder.path().to_str().unwrap())
            .unwrap_err()
            .to_string();
        assert!(missing.contains("system.jinja"), "{missing}");
        for name in &FILES[1..] {
            std::fs::write(folder.path().join(name), "x").unwrap();
        }
        let settings = PromptSet::open(folder.path().to_str().unwrap())
            .unwrap_err()
            .to_string();
        assert!(settings.contains("understandng"), "{settings}");
        let forms = "scene_text = 'compact'\nunderstanding = 'free'\ninstruction = 'choices'";
        std::fs::write(folder.path().join(SETTINGS), forms).unwrap();
        let own = PromptSet::open(folder.path().to_str().unwrap()).unwrap();
        assert!(
            !own.is_built_in() && own.place() == &PromptPlace::Folder(folder.path().to_owned())
        );
        assert_ne!(own.blake3(), PromptSet::open("paper").unwrap().blake3());
        // Each file, before the first scene: a feedback that nobody needs yet, too.
        for (name, text, said) in [
            ("code", "x\n{{ centerline }}", "code.jinja of set"),
            (
                "code",
                "x\n{{ centerline }}",
                "line 2: there is no variable centerline",
            ),
            (
                "feedback",
                "{{ scene_text }}",
                "there are code, score, threshold, parts, errors",
            ),
            (
                "system",
                "{{ ranges.v1 }}",
                "no variable ranges.v1; there are function, legend, ranges.v0",
            ),
        ] {
            let file = folder.path().join(format!("{name}.jinja"));
            std::fs::write(&file, text).unwrap();
            let error = PromptSet::open(folder.path().to_str().unwrap()).unwrap_err();
            assert!(error.to_string().contains(said), "{error}");
            std::fs::write(&file, "{% for x in range(2) %}{{ x }}{% endfor %}").unwrap();
            PromptSet::open(folder.path().to_str().unwrap()).unwrap();
        }
    }
}
