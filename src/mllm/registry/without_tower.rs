//! Descriptions of models that are opened without their vision tower (`vision = false`).

use super::{ModelSource, ModelSpec};

impl ModelSpec {
    /// Why a model cannot be opened without its vision tower.
    pub(super) fn check_blind(&self) -> Result<(), String> {
        let named = match &self.source {
            ModelSource::Endpoint(_) => {
                return Err(
                    "a server decides itself what it sees; set environment.bev = false".into(),
                );
            }
            ModelSource::File { mmproj, .. } => mmproj.is_some(),
            ModelSource::Hub { mmproj, .. } => mmproj.is_some(),
            ModelSource::Folder { .. } | ModelSource::Embedded { .. } => false,
        };
        if named {
            return Err("source.mmproj names a vision tower; remove one of the two".into());
        }
        if !self.image.is_default() {
            return Err("image says how pictures are shown; remove one of the two".into());
        }
        Ok(())
    }
}

pub(super) fn yes() -> bool {
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MllmError;
    use std::path::Path;

    fn parse(text: &str) -> Result<ModelSpec, MllmError> {
        ModelSpec::parse(Path::new("models/x.toml"), text)
    }

    #[test]
    fn a_decoder_is_opened_without_its_tower_as_a_description_says() {
        let valid =
            "name = 'n'\nvision = false\nsource = { file = 'm.gguf' }\nprompt_set = 'brief'\n";
        assert!(!parse(valid).unwrap().vision);
        assert!(
            parse(&valid.replace("vision = false\n", ""))
                .unwrap()
                .vision
        );
        for (from, to, said) in [
            ("'m.gguf'", "'m.gguf', mmproj = 'v.gguf'", "mmproj"),
            ("'brief'\n", "'brief'\n[image]\nsize = 448", "image"),
            (
                "file = 'm.gguf'",
                "endpoint = 'http://127.0.0.1:8080/v1', model = 'm', grammar = 'json_schema'",
                "bev",
            ),
            ("false", "'no'", "vision"),
        ] {
            let problem = parse(&valid.replace(from, to)).unwrap_err().to_string();
            assert!(problem.contains(said), "{to}: {problem}");
        }
    }
}
