//! Questions to a vision-language model.

use crate::errors::{Failure, Outcome, Raise};
use crate::settings::{config, model};
use crate::work::{computed, long, quick};
use image::RgbImage;
use planagent::runs::Config;
use planagent_mllm::{Constraint, Deadline, MllmError, PromptPrefix, Request as Question};
use planagent_runs::runner::LoadedModel;
use pyo3::prelude::*;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A vision-language model.
#[pyclass(frozen, module = "planagent._core")]
pub(crate) struct Model {
    loaded: Arc<LoadedModel>,
    config: Config,
}

/// A picture: bytes, height, width.
type Picture = (Vec<u8>, u32, u32);

/// The parts of a question that have defaults.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Asked {
    system: String,
    max_tokens: usize,
    choices: Option<Vec<String>>,
    regex: Option<String>,
    deadline_s: Option<f64>,
    seed: Option<u64>,
}

impl Asked {
    fn constraint(&self) -> Outcome<Constraint> {
        match (&self.choices, &self.regex) {
            (None, None) => Ok(Constraint::Free),
            (Some(choices), None) => Ok(Constraint::Choice(choices.clone())),
            (None, Some(regex)) => Ok(Constraint::Regex(regex.clone())),
            (Some(_), Some(_)) => Err(Failure::argument(
                "an answer has choices or a regex; leave one of them out",
            )),
        }
    }

    /// An error of the model, by the argument that it comes from.
    fn failure(&self, error: MllmError) -> Failure {
        match (&error, self.deadline_s) {
            (MllmError::Deadline, Some(seconds)) => Failure::new(
                "ModelError",
                format!("there was no answer within {seconds} s; raise deadline_s"),
            ),
            (MllmError::Grammar { problem, .. }, _) => {
                let name = if self.regex.is_some() {
                    "regex"
                } else {
                    "choices"
                };
                Failure::argument(format!("{name} cannot be used: {problem}"))
            }
            _ => error.into(),
        }
    }

    fn deadline(&self) -> Outcome<Deadline> {
        let Some(seconds) = self.deadline_s else {
            return Ok(Deadline::NONE);
        };
        let limit = Duration::try_from_secs_f64(seconds);
        let limit = limit
            .map_err(|error| Failure::argument(format!("deadline_s is {seconds}: {error}")))?;
        Ok(Deadline::after(Instant::now(), limit))
    }
}

#[pymethods]
impl Model {
    /// Loads the model of settings as JSON; a model that is loaded already is shared.
    #[new]
    fn new(py: Python<'_>, settings: String) -> PyResult<Self> {
        let work = move || {
            let config = config(&settings)?;
            Ok(Self {
                loaded: model(&config)?,
                config,
            })
        };
        long(py, work, &|| ())
    }

    /// The model as JSON: name, architecture, size.
    fn about(&self, py: Python<'_>) -> PyResult<String> {
        let json = serde_json::to_string(&self.loaded.about);
        json.map_err(|error| Failure::panic(error.to_string()))
            .or_raise(py)
    }

    /// Number of tokens of a text; none where the model is behind a server.
    fn count_tokens(&self, py: Python<'_>, text: String) -> PyResult<Option<usize>> {
        quick(py, || {
            Ok(self
                .loaded
                .parts()
                .and_then(|(model, ..)| model.count_tokens(&text)))
        })
    }

    /// Asks; gives the answer, why it ended, its tokens and times (milliseconds) as JSON.
    #[pyo3(signature = (text, image, asked))]
    fn ask(
        &self,
        py: Python<'_>,
        text: String,
        image: Option<Picture>,
        asked: Asked,
    ) -> PyResult<(String, String, String, String, Option<f64>)> {
        let (loaded, config_seed) = (Arc::clone(&self.loaded), self.config.seed);
        let question = move || {
            let (model, _, reasoning) = loaded
                .parts()
                .ok_or_else(|| Failure::panic("there is no model to ask"))?;
            let image = match image {
                None => None,
                Some((bytes, height, width)) => {
                    let image = RgbImage::from_raw(width, height, bytes);
                    let wrong = || {
                        Failure::argument("an image has height x width x 3 numbers of type uint8")
                    };
                    Some(Arc::new(image.ok_or_else(wrong)?))
                }
            };
            let question = Question {
                constraint: asked.constraint()?,
                max_new_tokens: asked.max_tokens,
                sampling: reasoning.generation.sampling,
                deadline: asked.deadline()?,
                draft: None,
            };
            let prefix = PromptPrefix {
                system: asked.system.clone(),
                image,
            };
            let mut conversation = model.converse(&prefix, asked.seed.unwrap_or(config_seed))?;
            let answer = conversation.ask(&text, &question);
            let answer = answer.map_err(|error| asked.failure(error))?;
            let json = |value: serde_json::Result<String>| {
                value.map_err(|error| Failure::panic(error.to_string()))
            };
            let finish = json(serde_json::to_string(&answer.finish))?
                .trim_matches('"')
                .to_owned();
            let tokens = json(serde_json::to_string(&answer.tokens))?;
            Ok((
                answer.text.clone(),
                finish,
                tokens,
                json(serde_json::to_string(&answer.time))?,
                answer.log_probability,
            ))
        };
        long(py, || computed(question), &|| ())
    }
}
