//! Options of llama.cpp that name a model. `-hf` would be read as `-h`, and show the help.

use std::ffi::OsString;

/// Options with a repository of the hub, with a file of one, and with a file or an address.
const REPOSITORY: [&str; 3] = ["-hf", "-hfr", "--hf-repo"];
const FILE: [&str; 2] = ["-hff", "--hf-file"];
const MODEL: [&str; 3] = ["-m", "-mu", "--model-url"];
/// Options with the vision tower's file or its address.
const TOWER: [&str; 4] = ["-mm", "--mmproj", "-mmu", "--mmproj-url"];

/// What to write in place of an option of llama.cpp, if the arguments have one.
pub(super) fn instead(arguments: &[OsString]) -> Option<String> {
    let words: Vec<String> = arguments
        .iter()
        .map(|word| word.to_string_lossy().into_owned())
        .take_while(|word| word != "--")
        .collect();
    // The option of a group as it is written, and its value.
    let given = |group: &[&str]| {
        words.iter().enumerate().find_map(|(place, word)| {
            let (option, value) = match word.split_once('=') {
                Some((option, value)) => (option, Some(value)),
                None => (word.as_str(), words.get(place + 1).map(String::as_str)),
            };
            let value = value.filter(|value| !value.starts_with('-'));
            group.contains(&option).then(|| (option.to_owned(), value))
        })
    };
    let (repository, file) = (given(&REPOSITORY), given(&FILE));
    let (option, model) = match (repository, file) {
        (Some((option, repository)), Some((_, file))) => {
            let repository = repository.unwrap_or("ORG/NAME");
            let file = file.unwrap_or("FILE.gguf");
            (option, format!("{repository}/{file}"))
        }
        (Some((option, repository)), None) => {
            (option, repository.unwrap_or("ORG/NAME:QUANT").to_owned())
        }
        (None, Some((option, file))) => {
            (option, format!("ORG/NAME/{}", file.unwrap_or("FILE.gguf")))
        }
        (None, None) => {
            if let Some((option, file)) = given(&MODEL) {
                (option, file.unwrap_or("FILE.gguf").to_owned())
            } else {
                return given(&TOWER).map(|(option, _)| {
                    format!(
                        "{option} is an option of llama.cpp; put the tower beside the decoder, or name it under mmproj in \
                         the model's description"
                    )
                });
            }
        }
    };
    Some(format!(
        "{option} is an option of llama.cpp; write --model {model}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_of_llama_cpp_are_told_how_they_are_written_here() {
        let said = |words: &str| {
            let words: Vec<OsString> = words.split(' ').map(OsString::from).collect();
            instead(&words)
        };
        for (words, model) in [
            ("planagent ask x -hf org/n:Q8_0", "--model org/n:Q8_0"),
            ("planagent ask x --hf-repo=org/n", "--model org/n"),
            ("planagent -hf", "--model ORG/NAME:QUANT"),
            ("planagent ask -hff a.gguf x", "--model ORG/NAME/a.gguf"),
            (
                "planagent ask --hf-file a.gguf --hf-repo org/n x",
                "--model org/n/a.gguf",
            ),
            (
                "planagent ask x -m a.gguf --mmproj b.gguf",
                "--model a.gguf",
            ),
            (
                "planagent ask -mu https://huggingface.co/a/b x",
                "--model https://huggingface.co/a/b",
            ),
            (
                "planagent ask x --model a.gguf --mmproj b.gguf",
                "under mmproj in the model's description",
            ),
        ] {
            let said = said(words).unwrap();
            assert!(said.ends_with(model), "{said}");
        }
        for words in [
            "planagent ask x -h",
            "planagent simulate --planner x=exec:a -- -hf",
            "planagent ask --model org/n",
        ] {
            assert_eq!(said(words), None, "{words}");
        }
    }
}
