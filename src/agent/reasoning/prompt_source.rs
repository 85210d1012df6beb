//! Where the templates of a prompt set come from: a folder on disk, else the program.

use super::error::PromptError;
use planagent_mllm::data_folder;
use std::fmt;
use std::path::{Path, PathBuf};

/// Folder of prompt sets that override the built-in ones.
const PROMPTS: &str = "prompts";
/// Environment variable that names another folder.
const PROMPTS_VARIABLE: &str = "PLANAGENT_PROMPTS";

/// Where the templates of a set are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PromptPlace {
    /// In the program.
    BuiltIn,
    /// In a folder.
    Folder(PathBuf),
}

impl fmt::Display for PromptPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BuiltIn => f.write_str("built in"),
            Self::Folder(folder) => write!(f, "{}", folder.display()),
        }
    }
}

/// The files of a prompt set.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct PromptFiles {
    pub(super) name: String,
    pub(super) place: PromptPlace,
    /// Names with texts.
    pub(super) texts: Vec<(&'static str, String)>,
}

/// A set that is compiled into the program: name, and its files.
type BuiltIn = (&'static str, &'static [(&'static str, &'static str)]);

macro_rules! built_in {
    ($name:literal: $($file:literal),*) => {
        ($name, &[$(($file, include_str!(concat!("../../../prompts/", $name, "/", $file)))),*])
    };
}

const BUILT_IN: [BuiltIn; 7] = [
    built_in!("paper": "set.toml", "system.jinja", "understanding.jinja", "instruction.jinja", "code.jinja", "feedback.jinja"),
    built_in!("brief": "set.toml", "system.jinja", "understanding.jinja", "instruction.jinja", "code.jinja", "feedback.jinja"),
    built_in!("compact": "set.toml", "system.jinja", "understanding.jinja", "instruction.jinja", "code.jinja", "feedback.jinja"),
    built_in!("compact-2": "set.toml", "system.jinja", "understanding.jinja", "instruction.jinja", "code.jinja", "feedback.jinja"),
    built_in!("llm_assist_unc": "system.jinja", "question.jinja"),
    built_in!("llm_assist_par": "system.jinja", "question.jinja"),
    built_in!("ask": "system.jinja", "question.jinja"),
];

/// The names of the prompt sets of a planning call that the program has.
pub(super) fn built_in_sets() -> impl Iterator<Item = &'static str> {
    let of_calls = |(_, files): &&BuiltIn| files.iter().any(|(file, _)| *file == "set.toml");
    BUILT_IN.iter().filter(of_calls).map(|(name, _)| *name)
}

/// The texts of the prompt sets in the program.
pub fn built_in_prompts() -> impl Iterator<Item = &'static str> {
    BUILT_IN
        .iter()
        .flat_map(|(_, files)| files.iter().map(|&(_, text)| text))
}

impl PromptFiles {
    /// The set of a name: from the folder of prompt sets, else from the program, else from the
    /// folder that the name is a path of. It has the files `names`, the first of which shows that a
    /// folder is a set.
    pub(super) fn find(name: &str, names: &[&'static str]) -> Result<Self, PromptError> {
        Self::find_in(&data_folder(PROMPTS_VARIABLE, PROMPTS), name, names)
    }

    /// The set of a name from the folder of prompt sets, else these texts of the program.
    pub(super) fn find_or(
        name: &str,
        texts: &[(&'static str, &'static str)],
    ) -> Result<Self, PromptError> {
        let folder = data_folder(PROMPTS_VARIABLE, PROMPTS).join(name);
        let names: Vec<&'static str> = texts.iter().map(|(file, _)| *file).collect();
        if folder.is_dir() {
            return Self::read(name, &folder, &names);
        }
        let texts = texts.iter().map(|&(file, text)| (file, text.to_owned()));
        Ok(Self {
            name: name.to_owned(),
            place: PromptPlace::BuiltIn,
            texts: texts.collect(),
        })
    }

    fn find_in(prompts: &Path, name: &str, names: &[&'static str]) -> Result<Self, PromptError> {
        let override_folder = prompts.join(name);
        if !name.is_empty() && !name.contains(['/', '\\', '.']) && override_folder.is_dir() {
            return Self::read(name, &override_folder, names);
        }
        let first = names.first().copied().expect("a set has one file at least");
        let fits = |(_, files): &&BuiltIn| files.iter().any(|(file, _)| *file == first);
        if let Some(built_in) = BUILT_IN
            .iter()
            .filter(fits)
            .find(|(known, _)| *known == name)
        {
            return Ok(Self::built_in(built_in));
        }
        let folder = Path::new(name);
        if folder.join(first).is_file() {
            return Self::read(name, folder, names);
        }
        let known = BUILT_IN
            .iter()
            .filter(fits)
            .map(|(known, _)| *known)
            .collect();
        Err(PromptError::Unknown {
            name: name.to_owned(),
            known,
        })
    }

    fn built_in(&(name, files): &BuiltIn) -> Self {
        let texts = files
            .iter()
            .map(|&(file, text)| (file, text.to_owned()))
            .collect();
        Self {
            name: name.to_owned(),
            place: PromptPlace::BuiltIn,
            texts,
        }
    }

    fn read(name: &str, folder: &Path, names: &[&'static str]) -> Result<Self, PromptError> {
        let read = |&file: &&'static str| {
            let path = folder.join(file);
            let text = planagent_files::read_text(&path, planagent_files::MAX_SETTINGS_BYTES);
            text.map(|text| (file, text))
                .map_err(|source| PromptError::Read { path, source })
        };
        let texts = names.iter().map(read).collect::<Result<_, _>>()?;
        Ok(Self {
            name: name.to_owned(),
            place: PromptPlace::Folder(folder.to_owned()),
            texts,
        })
    }

    /// The text of a file; empty where the set has none of this name.
    pub(super) fn text(&self, file: &str) -> &str {
        self.texts
            .iter()
            .find(|(name, _)| *name == file)
            .map_or("", |(_, text)| text)
    }

    /// The path of a file in messages.
    pub(super) fn path(&self, file: &str) -> PathBuf {
        match &self.place {
            PromptPlace::BuiltIn => Path::new(&self.name).join(file),
            PromptPlace::Folder(folder) => folder.join(file),
        }
    }

    /// The templates: name without `.jinja`, and text.
    pub(super) fn templates(&self) -> impl Iterator<Item = (&'static str, String)> + '_ {
        self.texts
            .iter()
            .filter_map(|(file, text)| Some((file.strip_suffix(".jinja")?, text.clone())))
    }

    /// Whether the texts are those of the program.
    pub(super) fn is_built_in(&self) -> bool {
        let named = BUILT_IN.iter().find(|(name, _)| *name == self.name);
        named.is_some_and(|known| Self::built_in(known).texts == self.texts)
    }

    /// BLAKE3 of each text, hexadecimal, by set and file.
    pub(super) fn digests(&self) -> Vec<(String, String)> {
        let digest = |text: &str| blake3::hash(text.as_bytes()).to_hex().to_string();
        self.texts
            .iter()
            .map(|(file, text)| (format!("{}/{file}", self.name), digest(text)))
            .collect()
    }

    /// Adds name and texts to a digest.
    pub(super) fn hash(&self, hasher: &mut blake3::Hasher) {
        let mut part = |text: &str| {
            hasher
                .update(&(text.len() as u64).to_le_bytes())
                .update(text.as_bytes());
        };
        for (file, text) in &self.texts {
            part(file);
            part(text);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILES: [&str; 2] = ["system.jinja", "question.jinja"];

    #[test]
    fn a_folder_of_prompts_overrides_the_program_and_is_read_whole() {
        let prompts = tempfile::tempdir().unwrap();
        let find = |name: &str| PromptFiles::find_in(prompts.path(), name, &FILES);
        let program = find("llm_assist_par").unwrap();
        assert_eq!(
            (program.place.to_string().as_str(), program.is_built_in()),
            ("built in", true)
        );
        let folder = prompts.path().join("llm_assist_par");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(folder.join("system.jinja"), "Be careful.").unwrap();
        let incomplete = find("llm_assist_par").unwrap_err().to_string();
        assert!(incomplete.contains("question.jinja"), "{incomplete}");
        std::fs::write(
            folder.join("question.jinja"),
            program.text("question.jinja"),
        )
        .unwrap();
        let edited = find("llm_assist_par").unwrap();
        assert_eq!(
            (&edited.place, edited.is_built_in()),
            (&PromptPlace::Folder(folder.clone()), false)
        );
        std::fs::write(folder.join("system.jinja"), program.text("system.jinja")).unwrap();
        assert!(
            find("llm_assist_par").unwrap().is_built_in(),
            "the same texts are the same set, wherever they are"
        );
        assert!(matches!(find("nowhere"), Err(PromptError::Unknown { .. })));
        assert_eq!(
            find(folder.to_str().unwrap()).unwrap().place,
            PromptPlace::Folder(folder)
        );
    }
}
