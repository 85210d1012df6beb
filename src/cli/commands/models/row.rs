//! What is known of a described model.

use super::check::reason;
use planagent_agent::reasoning;
use planagent_lab::bench::{CallBudget, CallEstimate, machine_limits};
use planagent_mllm::{
    Architecture, ImageRange, MemoryNeed, ModelOutline, ModelRegistry, ModelSource, ModelSpec,
    PromptSet,
};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Origin of what the program itself holds.
pub(super) const BUILT_IN: &str = "built in";

/// A described model.
#[derive(Debug, Default, Serialize)]
pub(super) struct Row {
    /// Its name for `--model`.
    pub model: String,
    /// Its family; none if nothing says it.
    pub family: Option<&'static str>,
    /// What its files call it, where that is no known family.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kind: Option<String>,
    /// Where it comes from.
    pub source: Option<String>,
    /// Whether it runs on a server.
    pub server: bool,
    /// Where its files are on this machine.
    pub place: Option<PathBuf>,
    /// Bytes of its weight files.
    pub bytes: Option<u64>,
    /// Why it cannot be used.
    pub problem: Option<String>,
    /// Its description: a file, or `built in`.
    pub description: Option<String>,
    /// What is merged into its weights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub adapter: Option<String>,
    /// Its prompt set.
    pub prompt_set: Option<String>,
    /// Where the templates of its prompt set are: a folder, or `built in`.
    pub prompts: Option<String>,
    /// The license of its weights.
    pub license: Option<String>,
    /// Number of weights.
    pub parameters: Option<u64>,
    /// Side of the BEV map that is drawn for it, pixels.
    pub image_size: Option<usize>,
    /// Tokens of that map.
    pub image_tokens: Option<usize>,
    /// How many tokens an image may become, where the tower takes any size.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub image_range: Option<ImageRange>,
    /// Longest chat, tokens.
    pub context: Option<usize>,
    /// Memory in each weight format, bytes.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub memory: BTreeMap<&'static str, MemoryNeed>,
    /// What a planning call in each weight format is estimated to take on this machine.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub call: BTreeMap<&'static str, CallEstimate>,
}

impl Row {
    pub(super) fn for_model(name: String, registry: &ModelRegistry) -> Self {
        // A model that cannot be found or opened is a row, too: a list does not end at it.
        let spec = match registry.find(&name) {
            Ok(spec) => spec,
            Err(error) => {
                return Self {
                    model: name,
                    problem: Some(error.to_string()),
                    ..Self::default()
                };
            }
        };
        let described = registry.names().is_ok_and(|names| names.contains(&name));
        let description = registry
            .description(&name)
            .map(|path| path.display().to_string());
        let description = description.or_else(|| described.then(|| BUILT_IN.to_owned()));
        let prompt_set = registry
            .asking_here(&spec)
            .ok()
            .map(|asking| asking.prompt_set);
        let row = Self {
            family: spec.architecture.map(Architecture::name),
            source: Some(spec.source.to_string()),
            description,
            prompts: prompt_set.as_deref().map(prompts),
            license: spec.license.clone(),
            prompt_set,
            model: name,
            ..Self::default()
        };
        if matches!(spec.source, ModelSource::Endpoint(_)) {
            return Self {
                server: true,
                ..row
            };
        }
        let here = registry
            .place_here(&spec)
            .and_then(|place| place.absent().map_or(Ok(place), Err));
        match here {
            Ok(place) => {
                let bytes = place.weight_bytes();
                let row = Self {
                    place: Some(place.path().to_path_buf()),
                    problem: bytes.as_ref().err().map(ToString::to_string),
                    bytes: bytes.ok(),
                    ..row
                }
                .outlined(&spec, registry);
                if row.parameters.is_none()
                    && let Some((kind, parameters)) = place.facts()
                {
                    return Self {
                        kind: row.family.is_none().then_some(kind),
                        parameters: Some(parameters),
                        ..row
                    };
                }
                row
            }
            Err(error) => Self {
                problem: Some(reason(&error, &row.model)),
                ..row
            }
            .outlined(&spec, registry),
        }
    }

    /// Adds what follows from the model's shape.
    fn outlined(self, spec: &ModelSpec, registry: &ModelRegistry) -> Self {
        let outline = match registry.outline(spec) {
            Ok(outline) => outline,
            // A model that is not here has its reason already.
            Err(error) => {
                return Self {
                    problem: self.problem.or_else(|| Some(error.to_string())),
                    ..self
                };
            }
        };
        let ModelOutline {
            family,
            parameters,
            image_size,
            image_tokens,
            image_range,
            context,
            formats,
            adapter,
            ..
        } = &outline;
        let budget = self.prompt_set.as_deref().and_then(PromptSet::named);
        let budget = budget.map(CallBudget::for_prompts);
        let call = budget.map_or_else(BTreeMap::new, |budget| {
            let formats = formats.iter().map(|format| format.weight_format);
            let limits = machine_limits();
            formats
                .filter_map(|format| {
                    let call = CallEstimate::new(&outline, format, &budget, limits)?;
                    Some((format.name(), call))
                })
                .collect()
        });
        Self {
            family: Some(*family),
            parameters: Some(*parameters),
            image_size: *image_size,
            image_tokens: image_size.and(Some(*image_tokens)),
            image_range: *image_range,
            context: Some(*context),
            adapter: adapter.as_ref().map(ToString::to_string),
            memory: formats
                .iter()
                .map(|format| (format.weight_format.name(), format.memory))
                .collect(),
            call,
            ..self
        }
    }

    /// What speaks against how its image is drawn.
    pub(super) fn image_warning(&self) -> Option<String> {
        let (range, tokens) = (self.image_range?, self.image_tokens?);
        (tokens < range.advised).then(|| {
            format!(
                "its makers advise at least {} tokens where places in the image matter; a larger \
                 image.size in its description gives more, and calls take longer",
                range.advised
            )
        })
    }

    /// Billions or millions of weights.
    pub(super) fn size(&self) -> Option<String> {
        self.parameters
            .map(|parameters| match parameters as f64 / 1e9 {
                billions @ 9.995.. => format!("{billions:.1}B"),
                billions @ 0.1.. => format!("{billions:.2}B"),
                billions @ 0.001.. => format!("{:.1}M", billions * 1e3),
                billions => format!("{:.0}K", billions * 1e6),
            })
    }
}

/// A number with three digits at most, or what it lies below.
pub(super) fn rounded(number: f64) -> String {
    match number {
        9.95.. => format!("{number:.0}"),
        0.05.. => format!("{number:.1}"),
        _ => "<0.1".to_owned(),
    }
}

/// Where the templates of a prompt set are, or why they cannot be used.
fn prompts(name: &str) -> String {
    reasoning::PromptSet::open(name)
        .map_or_else(|error| error.to_string(), |set| set.place().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drawn_image_of_few_tokens_is_warned_about() {
        let row = |tokens| Row {
            image_range: Some(ImageRange {
                least: 64,
                most: 16_384,
                advised: 1024,
            }),
            image_tokens: Some(tokens),
            ..Row::default()
        };
        let said = row(196).image_warning().unwrap();
        assert!(said.contains("at least 1024 tokens"), "{said}");
        assert_eq!(row(1024).image_warning(), None);
        assert_eq!(Row::default().image_warning(), None);
    }

    #[test]
    fn sizes_have_five_characters_and_numbers_four() {
        let size = |parameters| {
            Row {
                parameters: Some(parameters),
                ..Row::default()
            }
            .size()
            .unwrap()
        };
        assert_eq!(size(4_020_000), "4.0M");
        assert_eq!(size(74_900), "75K");
        assert_eq!(size(256_500_000), "0.26B");
        assert_eq!(size(9_999_000_000), "10.0B");
        assert_eq!(size(17_640_000_000), "17.6B");
        assert_eq!(
            [0.004, 0.26, 9.96, 142.6].map(rounded),
            ["<0.1", "0.3", "10", "143"]
        );
    }
}
