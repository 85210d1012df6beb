//! The wanted part of a repository.

use super::name::{HubName, is_gguf};
use crate::MllmError;
use crate::checkpoint::safetensors_folder::{has_safetensors, weight_files};
use crate::gguf::{TOWER_FORMATS, named_parts};
use std::path::{Path, PathBuf};

/// Names of files that a message lists.
const MAX_LISTED: usize = 20;
/// Folders inside each other that are searched for the files of a snapshot.
const MAX_DEPTH: usize = 4;
/// Small files that complete a GGUF file.
const BESIDE_GGUF: [&str; 3] = [
    "tokenizer.json",
    "tokenizer_config.json",
    "chat_template.jinja",
];

/// The wanted part of a repository.
#[derive(Debug, Clone)]
pub(in crate::registry) enum HubFiles {
    /// Safetensors with their small files.
    Model {
        /// Whether the tokenizer is among them.
        tokenizer: bool,
    },
    /// A tokenizer alone.
    Tokenizer,
    /// A GGUF file with its vision tower.
    Gguf {
        model: GgufChoice,
        /// The tower; without a name, the one that fits best.
        mmproj: Option<String>,
    },
}

/// Which GGUF file of a repository is the model.
#[derive(Debug, Clone)]
pub(in crate::registry) enum GgufChoice {
    /// The file of this path.
    File(String),
    /// The only one of this weight format.
    Quant(String),
}

/// GGUF files by their paths in the repository.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::registry) struct GgufNames {
    pub model: String,
    pub mmproj: Option<String>,
}

impl HubFiles {
    /// Patterns of the files to download, where they exist; for GGUF files these are all that is
    /// wanted of `repository`.
    #[cfg_attr(not(feature = "hub"), allow(dead_code))]
    pub(super) fn patterns(
        &self,
        name: &HubName,
        repository: &[String],
    ) -> Result<Vec<String>, String> {
        let owned = |names: &[&str]| names.iter().map(ToString::to_string).collect();
        Ok(match self {
            Self::Model { .. } => owned(&["*.json", "*.jinja", "*.safetensors"]),
            Self::Tokenizer => owned(&["tokenizer.json", "tokenizer_config.json"]),
            Self::Gguf { .. } => {
                let GgufNames { model, mmproj } = self.chosen(name, repository)?;
                let mut patterns: Vec<String> = owned(&BESIDE_GGUF);
                let parts = named_parts(&model);
                patterns.extend(parts.into_iter().chain(mmproj).map(|file| escaped(&file)));
                patterns
            }
        })
    }

    /// A file that a snapshot lacks.
    pub(super) fn missing(&self, name: &HubName, folder: &Path) -> Option<String> {
        let required: &[&str] = match self {
            Self::Model { tokenizer: true } => &["config.json", "tokenizer.json"],
            Self::Model { tokenizer: false } => &["config.json"],
            Self::Tokenizer => &["tokenizer.json"],
            Self::Gguf { model, mmproj } => {
                let model = match model {
                    GgufChoice::File(file) => file.clone(),
                    GgufChoice::Quant(quant) => match self.chosen(name, &listed(folder)) {
                        Ok(names) => names.model,
                        Err(_) => return Some(format!("a GGUF file of format {quant}")),
                    },
                };
                let mut files = named_parts(&model).into_iter().chain(mmproj.clone());
                return files.find(|file| !folder.join(file).is_file());
            }
        };
        if let Some(file) = required.iter().find(|file| !folder.join(file).is_file()) {
            return Some((*file).to_owned());
        }
        if matches!(self, Self::Tokenizer) {
            return None;
        }
        if !has_safetensors(folder) {
            return Some("model.safetensors".into());
        }
        // A damaged index is no missing file; opening the model says what is wrong with it.
        match weight_files(folder) {
            Err(MllmError::MissingFile { file, .. }) => Some(file),
            _ => None,
        }
    }

    /// The wanted GGUF files of a repository with these files, or why there are none.
    pub(super) fn chosen(
        &self,
        name: &HubName,
        repository: &[String],
    ) -> Result<GgufNames, String> {
        let Self::Gguf { model, mmproj } = self else {
            return Err("no GGUF file is wanted".into());
        };
        // Each error lists what may be named instead.
        let model = match model {
            GgufChoice::File(file) if repository.contains(file) => file.clone(),
            GgufChoice::File(file) => {
                return Err(format!(
                    "the repository has no {file}{}",
                    offered(name, repository)
                        .map_or(String::new(), |offered| format!("; {offered}"))
                ));
            }
            GgufChoice::Quant(quant) => {
                let named: Vec<&String> = models(repository)
                    .filter(|file| has_format(file, quant))
                    .collect();
                match named.as_slice() {
                    [one] => (*one).clone(),
                    [] => {
                        let offered = offered(name, repository).unwrap_or_else(|| {
                            format!(
                                "it has no GGUF files; name it as {}, and the format by --quantize",
                                name.id
                            )
                        });
                        return Err(format!(
                            "the repository has no GGUF file of format {quant}; {offered}"
                        ));
                    }
                    _ => {
                        let several = named.into_iter().cloned().collect::<Vec<_>>();
                        let offered = offered(name, &several)
                            .expect("files of a format are files that are offered");
                        return Err(format!(
                            "several GGUF files are of format {quant}; {offered}"
                        ));
                    }
                }
            }
        };
        let mmproj = match mmproj {
            Some(tower) if repository.contains(tower) => Some(tower.clone()),
            Some(tower) => return Err(format!("the repository has no {tower}")),
            None => tower_of(&model, repository),
        };
        Ok(GgufNames { model, mmproj })
    }
}

/// A hint at the GGUF files of a repository; `None` where it has none.
pub(super) fn offered(name: &HubName, repository: &[String]) -> Option<String> {
    let bare = HubName {
        quant: None,
        file: None,
        ..name.clone()
    };
    let mut words: Vec<String> = models(repository)
        .map(|file| format!("{}/{file}", bare.word()))
        .collect();
    words.sort();
    let more = words.len().saturating_sub(MAX_LISTED);
    words.truncate(MAX_LISTED);
    if more > 0 {
        words.push(format!("{more} more"));
    }
    (!words.is_empty()).then(|| {
        format!(
            "name a GGUF file as ORG/NAME/FILE.gguf: {}",
            words.join(", ")
        )
    })
}

/// The GGUF files that may be models: no towers, no importance matrices, and of a split model the
/// first part alone.
fn models(repository: &[String]) -> impl Iterator<Item = &String> {
    repository.iter().filter(|file| {
        let low = file.to_ascii_lowercase();
        is_gguf(Path::new(file))
            && !is_tower(file)
            && !low.contains("imatrix")
            && (!is_part(&low) || low.contains("-00001-of-"))
    })
}

/// Whether a file is a part of a split model, as `gguf-split` names it.
fn is_part(low: &str) -> bool {
    let Some((before, count)) = low
        .strip_suffix(".gguf")
        .and_then(|stem| stem.rsplit_once("-of-"))
    else {
        return false;
    };
    let digits = |text: &str| text.len() == 5 && text.bytes().all(|byte| byte.is_ascii_digit());
    let number = before.rsplit_once('-').map_or("", |(_, number)| number);
    digits(count) && digits(number)
}

fn is_tower(file: &str) -> bool {
    is_gguf(Path::new(file)) && file.to_ascii_lowercase().contains("mmproj")
}

/// Whether a path has the name of a weight format as a word of its own, in any case.
fn has_format(file: &str, format: &str) -> bool {
    let (low, format) = (file.to_ascii_lowercase(), format.to_ascii_lowercase());
    let part_of_word =
        |byte: Option<u8>| byte.is_some_and(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
    low.match_indices(&format).any(|(at, _)| {
        let before = at.checked_sub(1).and_then(|at| low.as_bytes().get(at));
        let after = low.as_bytes().get(at + format.len());
        !part_of_word(before.copied()) && !part_of_word(after.copied())
    })
}

/// The tower for a model: named after it, else in its folder, else in the repository; of several
/// the one in the best of the usual formats.
fn tower_of(model: &str, repository: &[String]) -> Option<String> {
    let folder = |file: &str| {
        file.rsplit_once('/')
            .map_or("", |(folder, _)| folder)
            .to_owned()
    };
    let last = |file: &str| {
        file.rsplit_once('/')
            .map_or(file, |(_, last)| last)
            .to_owned()
    };
    let rank = |file: &str| {
        let format = TOWER_FORMATS
            .iter()
            .position(|format| has_format(file, format))
            .unwrap_or(TOWER_FORMATS.len());
        (
            last(file) != format!("mmproj-{}", last(model)),
            folder(file) != folder(model),
            format,
            file.to_owned(),
        )
    };
    repository
        .iter()
        .filter(|file| is_tower(file))
        .min_by_key(|file| rank(file))
        .cloned()
}

/// A name as a pattern that it alone matches.
fn escaped(file: &str) -> String {
    file.chars()
        .flat_map(|character| {
            let special = "*?[]{}!\\".contains(character);
            let wrapped = special.then_some(['[', character, ']']);
            let plain = (!special).then_some(character);
            wrapped.into_iter().flatten().chain(plain)
        })
        .collect()
}

/// The files of a snapshot by their paths in the repository, sorted.
pub(super) fn listed(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![(PathBuf::new(), 0)];
    while let Some((inside, depth)) = folders.pop() {
        let Ok(entries) = std::fs::read_dir(folder.join(&inside)) else {
            continue;
        };
        for entry in entries.flatten() {
            let path = inside.join(entry.file_name());
            let place = folder.join(&path);
            if place.is_file() {
                let parts: Vec<_> = path
                    .iter()
                    .map(|part| part.to_string_lossy().into_owned())
                    .collect();
                found.push(parts.join("/"));
            } else if place.is_dir() && depth < MAX_DEPTH {
                folders.push((path, depth + 1));
            }
        }
    }
    found.sort();
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name() -> HubName {
        HubName {
            id: "org/n".into(),
            ..HubName::default()
        }
    }

    fn files(names: &[&str]) -> Vec<String> {
        names.iter().map(ToString::to_string).collect()
    }

    fn quant(word: &str) -> HubFiles {
        HubFiles::Gguf {
            model: GgufChoice::Quant(word.into()),
            mmproj: None,
        }
    }

    #[test]
    fn a_format_is_a_word_of_the_name() {
        let repository = files(&[
            "README.md",
            "m-Q4_K_M.gguf",
            "m-Q4_K_S.gguf",
            "m-IQ4_XS.gguf",
            "m-UD-Q4_K_XL.gguf",
            "m.f16.gguf",
            "Q8_0/m-Q8_0-00001-of-00002.gguf",
            "Q8_0/m-Q8_0-00002-of-00002.gguf",
            "m-imatrix.gguf",
            "mmproj-F32.gguf",
            "mmproj-f16.gguf",
        ]);
        let chosen = |word: &str| quant(word).chosen(&name(), &repository);
        for (word, model) in [
            ("q4_k_m", "m-Q4_K_M.gguf"),
            ("IQ4_XS", "m-IQ4_XS.gguf"),
            ("Q4_K_XL", "m-UD-Q4_K_XL.gguf"),
            ("F16", "m.f16.gguf"),
            ("Q8_0", "Q8_0/m-Q8_0-00001-of-00002.gguf"),
        ] {
            let names = chosen(word).unwrap();
            assert_eq!(names.model, model, "{word}");
            assert_eq!(names.mmproj.as_deref(), Some("mmproj-f16.gguf"), "{word}");
        }
        for word in ["Q4_K", "XS", "F32", "Q2_K"] {
            let problem = chosen(word).unwrap_err();
            assert!(problem.contains("org/n/m-Q4_K_M.gguf"), "{problem}");
            assert!(
                !problem.contains("mmproj") && !problem.contains("imatrix"),
                "{problem}"
            );
        }
    }

    #[test]
    fn two_files_of_a_format_are_both_named() {
        let repository = files(&["a-Q8_0.gguf", "b-q8_0.gguf", "c-Q4_0.gguf"]);
        let problem = quant("Q8_0").chosen(&name(), &repository).unwrap_err();
        assert!(problem.contains("several GGUF files"), "{problem}");
        assert!(
            problem.contains("org/n/a-Q8_0.gguf, org/n/b-q8_0.gguf") && !problem.contains("c-Q4"),
            "{problem}"
        );
    }

    #[test]
    fn a_format_of_a_repository_without_gguf_files_is_told_how_it_is_named() {
        let repository = files(&["config.json", "model.safetensors"]);
        let problem = quant("Q8_0").chosen(&name(), &repository).unwrap_err();
        assert!(
            problem.ends_with("name it as org/n, and the format by --quantize"),
            "{problem}"
        );
        assert_eq!(offered(&name(), &repository), None);
    }

    #[test]
    fn a_tower_lies_near_its_model() {
        let repository = files(&[
            "a/m.gguf",
            "a/mmproj-q8_0.gguf",
            "b/m.gguf",
            "b/mmproj-bf16.gguf",
            "b/mmproj-m.gguf",
            "mmproj-f16.gguf",
        ]);
        let tower = |model| tower_of(model, &repository).unwrap();
        assert_eq!(tower("a/m.gguf"), "b/mmproj-m.gguf", "named after it");
        assert_eq!(tower("a/other.gguf"), "a/mmproj-q8_0.gguf");
        assert_eq!(tower("other.gguf"), "mmproj-f16.gguf");
        assert_eq!(tower_of("m.gguf", &files(&["m.gguf"])), None);
    }

    #[test]
    fn a_name_is_no_pattern() {
        assert_eq!(escaped("a[1]*.gguf"), "a[[]1[]][*].gguf");
    }
}
