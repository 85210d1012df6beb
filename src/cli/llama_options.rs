//! Options of llama.cpp that name a model. `-hf` would be read as `-h`, and show the help.

use std::ffi::OsString;

/// Options with a repository of the hub, and with a file of one.
const REPOSITORY: [&str; 3] = ["-hf", "-hfr", "--hf-repo"];
const FILE: [&str; 2] = ["-hff", "--hf-file"];

/// What to write in place of an option of llama.cpp, if the arguments have one.
pub(super) fn instead(arguments: &[OsString]) -> Option<String> {
    let words: Vec<String> = arguments
        .iter()
        .map(|word| word.to_string_lossy().into_owned())
        .take_while(|word| word != "--")
        .collect();
    for (place, word) in words.iter().enumerate() {
        let (option, value) = match word.split_once('=') {
            Some((option, value)) => (option, Some(value)),
            None => (word.as_str(), words.get(place + 1).map(String::as_str)),
        };
        let value = value.filter(|value| !value.starts_with('-'));
        if REPOSITORY.contains(&option) {
            let value = value.unwrap_or("ORG/NAME:QUANT");
            return Some(format!(
                "{option} is an option of llama.cpp; write --model {value}"
            ));
        }
        if FILE.contains(&option) {
            let value = value.unwrap_or("FILE.gguf");
            return Some(format!(
                "{option} is an option of llama.cpp; write --model ORG/NAME/{value}"
            ));
        }
    }
    None
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
