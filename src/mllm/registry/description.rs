//! Model descriptions, `models/NAME.toml`.

use super::described_prompts::DescribedPrompts;
use super::generation::GenerationSettings;
use super::model_source::ModelSource;
use super::without_tower;
use crate::checkpoint::read_text;
use crate::{AdapterSpec, Architecture, EndpointSettings, ImageSettings, MllmError, WeightFormat};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The description of a model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelSpec {
    /// The name in results.
    pub name: String,
    /// The family that its `config.json` must name; none for any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub architecture: Option<Architecture>,
    pub source: ModelSource,
    /// The license of its weights: its name, perhaps with a comma and a remark behind it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub license: Option<String>,
    /// Format of its weights in memory, where no setting names one; none for that of its files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[serde(deserialize_with = "WeightFormat::choice")]
    pub quantize: Option<WeightFormat>,
    /// What is merged into its weights, where no setting names another.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub adapter: Option<AdapterSpec>,
    /// Where its tokenizer is; none if among its files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tokenizer: Option<ModelSource>,
    /// A small model of the same vocabulary that drafts its answers. None of them changes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub draft_model: Option<ModelSource>,
    /// The prompts that it is asked with; a description names them. None for a model without one,
    /// whose files may say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prompt_set: Option<DescribedPrompts>,
    #[serde(default)]
    pub generation: GenerationSettings,
    /// How images are shown to it.
    #[serde(default, skip_serializing_if = "ImageSettings::is_default")]
    pub image: ImageSettings,
    /// Whether the decoder of a GGUF file is opened with its vision tower, if it has one. Without,
    /// it is a language model that reads text alone.
    #[serde(default = "without_tower::yes", skip_serializing_if = "Clone::clone")]
    pub vision: bool,
    /// Whether its author vouches for its chat template and tokenizer, so that they need no trial.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub trusted: bool,
}

impl ModelSpec {
    /// A model without a description.
    pub(super) fn plain(name: String, source: ModelSource) -> Self {
        Self {
            name,
            architecture: None,
            source,
            license: None,
            quantize: None,
            adapter: None,
            tokenizer: None,
            draft_model: None,
            prompt_set: None,
            generation: GenerationSettings::default(),
            image: ImageSettings::default(),
            vision: true,
            trusted: false,
        }
    }

    /// Its draft model, which its author vouches for as for itself.
    pub(super) fn draft(&self) -> Option<Self> {
        let source = self.draft_model.clone()?;
        Some(Self {
            trusted: self.trusted,
            ..Self::plain(format!("draft_model of {}", self.name), source)
        })
    }

    pub fn open(path: &Path) -> Result<Self, MllmError> {
        Self::parse(path, &read_text(path)?)
    }

    /// Parses a description; `path` is for messages and relative paths.
    pub fn parse(path: &Path, text: &str) -> Result<Self, MllmError> {
        let broken = |problem: String| MllmError::Description {
            path: path.to_path_buf(),
            problem,
        };
        let mut spec: Self = toml::from_str(text).map_err(|error| {
            broken(endpoint_problem(text).unwrap_or_else(|| with_new_name(error.to_string())))
        })?;
        let base = path.parent().unwrap_or(Path::new(""));
        spec.check(base).map_err(broken)?;
        Ok(spec)
    }

    /// Checks the keys against each other, and makes relative paths start at `base`.
    fn check(&mut self, base: &Path) -> Result<(), String> {
        // serde checks each key alone; keys that exclude each other are found here.
        if self.name.trim().is_empty() {
            return Err("name is empty".into());
        }
        let Some(prompts) = &mut self.prompt_set else {
            return Err(
                "prompt_set is missing; choose brief, compact, compact-2 or paper, or name a folder of \
                 templates"
                    .into(),
            );
        };
        prompts.start_at(base)?;
        self.check_generation()?;
        if let ModelSource::Endpoint(settings) = &self.source {
            self.check_server(settings)?;
        }
        if let Some(adapter) = &mut self.adapter {
            adapter.start_at(base);
        }
        if !self.vision {
            self.check_blind()
                .map_err(|problem| format!("vision = false: {problem}"))?;
        }
        self.check_companions()?;
        let sources = [
            Some(&mut self.source),
            self.tokenizer.as_mut(),
            self.draft_model.as_mut(),
        ];
        for source in sources.into_iter().flatten() {
            source
                .take_hub_name()
                .map_err(|problem| format!("source.hub: {problem}"))?;
            source.start_at(base);
        }
        Ok(())
    }

    fn check_generation(&self) -> Result<(), String> {
        let tokens = self.generation.max_new_tokens;
        if [tokens.understanding, tokens.instruction, tokens.code].contains(&0) {
            return Err("generation.max_new_tokens: a round needs at least one token".into());
        }
        if self.generation.thinking == Some(0) {
            return Err(
                "generation.thinking: it needs at least one token; leave the key out for none"
                    .into(),
            );
        }
        Ok(())
    }

    /// The keys of a model behind a server, which computes alone.
    fn check_server(&self, settings: &EndpointSettings) -> Result<(), String> {
        if self.generation.thinking.is_some() {
            return Err(
                "generation.thinking belongs to models of this machine; a server has source.extra"
                    .into(),
            );
        }
        settings
            .described()
            .map_err(|problem| format!("source: {problem}"))?;
        if self.architecture.is_some() || self.tokenizer.is_some() {
            return Err("architecture and tokenizer belong to the server; remove them".into());
        }
        for (key, is_there) in [
            ("quantize", self.quantize.is_some()),
            ("adapter", self.adapter.is_some()),
        ] {
            if is_there {
                return Err(format!(
                    "{key} belongs to models of this machine; remove it"
                ));
            }
        }
        if !self.image.is_default() {
            return Err(
                "image belongs to models of this machine; a server has source.image_size".into(),
            );
        }
        Ok(())
    }

    /// The tokenizer and the draft model, which are files of this machine.
    fn check_companions(&self) -> Result<(), String> {
        if matches!(self.tokenizer, Some(ModelSource::Endpoint(_))) {
            return Err("tokenizer: expected files, found a server".into());
        }
        if matches!(
            self.draft_model,
            Some(ModelSource::Endpoint(_) | ModelSource::Embedded { .. })
        ) {
            return Err("draft_model: expected a folder, a GGUF file or a hub id".into());
        }
        if self.draft_model.is_some() && matches!(self.source, ModelSource::Endpoint(_)) {
            return Err(
                "draft_model belongs to models of this machine; a server drafts by itself".into(),
            );
        }
        Ok(())
    }
}

/// Keys of [`super::generation::RoundTokens`] that have other names now.
const RENAMED_ROUNDS: [(&str, &str); 2] = [("scene", "understanding"), ("motion", "instruction")];

/// An error about an unknown key, with its new name if it has one.
pub(super) fn with_new_name(error: String) -> String {
    let renamed = RENAMED_ROUNDS
        .iter()
        .find(|(old, _)| error.contains(&format!("unknown field `{old}`")));
    match renamed {
        Some((old, new)) => format!("{}; {old} is called {new} now", error.trim_end()),
        None => error,
    }
}

/// The error of a server's settings, if the description has one. The error of the untagged enum
/// would not name the key.
fn endpoint_problem(text: &str) -> Option<String> {
    let description: toml::Table = toml::from_str(text).ok()?;
    let source = description
        .get("source")?
        .as_table()
        .filter(|source| source.contains_key("endpoint"))?;
    let error = source.clone().try_into::<EndpointSettings>().err()?;
    Some(format!("source: {}", error.message()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Families, GrammarField, LimitField};
    use crate::{RoundTokens, Sampling};

    fn parse(text: &str) -> Result<ModelSpec, MllmError> {
        ModelSpec::parse(Path::new("models/x.toml"), text)
    }

    #[test]
    fn folders_lie_beside_the_description_and_settings_have_defaults() {
        let spec = parse(
            "name = 'nano'\narchitecture = 'llava'\nsource = { folder = 'nano' }\nprompt_set = 'compact'\n[generation.max_new_tokens]\ncode = 40",
        )
        .unwrap();
        assert_eq!(
            spec.source,
            ModelSource::Folder {
                folder: "models/nano".into()
            }
        );
        assert_eq!(
            spec.generation.max_new_tokens,
            RoundTokens {
                code: 40,
                ..RoundTokens::default()
            }
        );
        assert_eq!(spec.generation.sampling, Sampling::Greedy);
    }

    #[test]
    fn hub_sources_and_sampling_are_read() {
        let spec = parse(
            "name = 'l'\nsource = { hub = 'a/b' }\ntokenizer = { folder = 't' }\nprompt_set = 'paper'\n[generation]\nsampling = { sample = { temperature = 0.7, top_p = 0.9 } }",
        )
        .unwrap();
        let hub = |file: Option<&str>| ModelSource::Hub {
            hub: "a/b".into(),
            revision: "main".into(),
            file: file.map(Into::into),
            quant: None,
            mmproj: None,
        };
        assert_eq!(spec.source, hub(None));
        let source = |text: &str| {
            let spec = parse(&format!(
                "name = 'l'\nsource = {{ {text} }}\nprompt_set = 'paper'"
            ))?;
            Ok::<_, MllmError>(spec.source.to_string())
        };
        for (text, shown) in [
            ("hub = 'https://huggingface.co/a/b'", "a/b"),
            ("hub = 'a/b@v1'", "a/b (v1)"),
            ("hub = 'hf.co/a/b:Q8_0'", "a/b:Q8_0"),
            ("hub = 'a/b', quant = 'Q4_K_M'", "a/b:Q4_K_M"),
            ("hub = 'a/b/m.gguf'", "a/b/m.gguf"),
        ] {
            assert_eq!(source(text).unwrap(), shown);
        }
        for text in [
            "hub = 'a b'",
            "hub = 'a/b:Q8_0', file = 'm.gguf'",
            "hub = 'https://huggingface.co/datasets/a/b'",
        ] {
            let error = source(text).unwrap_err().to_string();
            assert!(error.contains("source.hub: "), "{error}");
        }
        let gguf =
            parse("name = 'l'\nsource = { hub = 'a/b', file = 'm.gguf' }\nprompt_set = 'paper'")
                .unwrap();
        assert_eq!(
            (gguf.source.to_string().as_str(), gguf.source),
            ("a/b/m.gguf", hub(Some("m.gguf")))
        );
        let file = parse(
            "name = 'l'\nsource = { file = 'm.gguf', mmproj = 'v.gguf' }\nprompt_set = 'paper'",
        )
        .unwrap();
        let (model, tower) = ("models/m.gguf".into(), Some("models/v.gguf".into()));
        assert_eq!(
            file.source,
            ModelSource::File {
                file: model,
                mmproj: tower
            }
        );
        assert_eq!(
            (spec.architecture, spec.tokenizer),
            (
                None,
                Some(ModelSource::Folder {
                    folder: "models/t".into()
                })
            )
        );
        assert_eq!(
            spec.generation.sampling,
            Sampling::Sample {
                temperature: 0.7,
                top_p: 0.9
            }
        );
    }

    #[test]
    fn a_server_is_described_by_its_address_and_what_it_takes() {
        let valid = "name = 'g'\nprompt_set = 'paper'\nsource = { endpoint = 'https://a.b/v1', model = 'm', \
            grammar = 'json_schema', limit = 'max_completion_tokens', key_env = 'THE_API_KEY', omit = ['seed'], \
            extra = { reasoning_effort = 'none' } }";
        let ModelSource::Endpoint(settings) = parse(valid).unwrap().source else {
            panic!("no endpoint")
        };
        assert_eq!(
            (settings.grammar, settings.limit),
            (GrammarField::JsonSchema, LimitField::MaxCompletionTokens)
        );
        assert_eq!(settings.extra["reasoning_effort"], "none");
        assert_eq!(
            settings.url().unwrap().as_str(),
            "https://a.b/v1/chat/completions"
        );
        for (from, to, said) in [
            ("grammar = 'json_schema', ", "", "grammar"),
            ("'json_schema'", "'ebnf'", "gbnf"),
            ("limit", "limits", "limits"),
            ("'m'", "' '", "model"),
            ("https://a.b", "ftp://a.b", "http"),
            ("https://a.b", "https://key@a.b", "key_env"),
            ("THE_API_KEY", "AWS_SECRET_ACCESS_KEY", "PLANAGENT_KEY_ENV"),
            ("'https://a.b/v1'", "'a.b'", "address"),
            ("model =", "image_size = 8, model =", "image_size"),
            ("model =", "timeout_ms = 0, model =", "timeout_ms"),
            (
                "name = 'g'",
                "name = 'g'\narchitecture = 'llava'",
                "architecture",
            ),
        ] {
            let problem = parse(&valid.replace(from, to)).unwrap_err().to_string();
            assert!(
                problem.starts_with("models/x.toml: ") && problem.contains(said),
                "{to}: {problem}"
            );
        }
    }

    #[test]
    fn images_are_shown_as_a_description_says() {
        let valid = "name = 'n'\nsource = { folder = 'f' }\nprompt_set = 'paper'\n";
        assert!(parse(valid).unwrap().image.is_default());
        let image = parse(&format!("{valid}[image]\ntiles = 1\nsize = 448"))
            .unwrap()
            .image;
        assert_eq!(
            image,
            ImageSettings {
                tiles: Some(1),
                size: Some(448)
            }
        );
    }

    #[test]
    fn every_architecture_has_the_name_that_results_call_it() {
        for architecture in Families::default().iter() {
            let name = architecture.name();
            let spec = parse(&format!(
                "name = 'm'\narchitecture = '{name}'\nsource = {{ folder = 'f' }}\nprompt_set = 'paper'"
            ));
            assert_eq!(spec.unwrap().architecture, Some(architecture));
        }
    }

    #[test]
    fn an_old_name_of_a_round_is_refused_with_the_new_one() {
        let valid = "name = 'n'\nsource = { folder = 'f' }\nprompt_set = 'paper'\n[generation.max_new_tokens]\n";
        for (old, new) in RENAMED_ROUNDS {
            assert!(parse(&format!("{valid}{new} = 3")).is_ok());
            let problem = parse(&format!("{valid}{old} = 3")).unwrap_err().to_string();
            assert!(
                problem.contains(&format!("{old} is called {new} now")),
                "{problem}"
            );
        }
    }

    #[test]
    fn wrong_keys_and_types_are_errors() {
        let valid =
            "name = 'n'\narchitecture = 'llava'\nsource = { folder = 'f' }\nprompt_set = 'paper'\n";
        assert!(parse(valid).is_ok());
        for wrong in [
            "",
            &valid.replace("llava", "blip"),
            &valid.replace("paper", "long"),
            &valid.replace("prompt_set = 'paper'", ""),
            &valid.replace("folder", "path"),
            &valid.replace("'n'", "''"),
            &format!("{valid}colour = 'red'"),
            &format!("{valid}[image]\ntile = 1"),
            &format!("{valid}[image]\nsize = 31"),
            &format!("{valid}[image]\nsize = 100000"),
            &format!("{valid}[generation]\nmax_new_tokens = 3"),
            &format!("{valid}[generation.max_new_tokens]\nunderstanding = 0"),
        ] {
            assert!(
                matches!(parse(wrong), Err(MllmError::Description { .. })),
                "{wrong}"
            );
        }
    }
}
