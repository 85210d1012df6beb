//! Models behind a server with `OpenAI`'s chat completions; vLLM, llama.cpp's server and Ollama
//! have them too.

mod ahead;
mod chat;
mod client;
mod encodings;
mod forms;
mod grammar;
mod hints;
mod key;
mod models;
mod packed;
mod probe;
mod reply;
mod trouble;
mod waits;

use super::sampling::answer_seed;
use super::{
    Answer, Constraint, ConstraintUse, Conversation, EndpointSettings, FinishReason, GrammarField,
    LoadReport, Mark, Mllm, MllmError, ModelDescription, ProbeQuestion, PromptPrefix, Request,
    RoundTime, Server, TokenCounts, Turn, milliseconds, prompt_hash,
};
use chat::{Chat, TurnImage};
use client::{Client, Question};
use image::RgbImage;
use key::ApiKey;
use reqwest::Url;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

/// How llama.cpp's server names itself in its list of models.
const LLAMA_CPP: &str = "llamacpp";

#[derive(Debug)]
pub struct Endpoint {
    name: String,
    settings: EndpointSettings,
    client: Client,
    /// Whether a probe was answered.
    probed: AtomicBool,
}

impl Endpoint {
    /// Reads the API key from the environment. Sends nothing before the first question, except
    /// where the settings name no model: then the server's list is asked for. `name` is the model's
    /// name in results.
    pub fn open(name: &str, settings: &EndpointSettings) -> Result<Self, MllmError> {
        let invalid = |problem: String| MllmError::Request { problem };
        let url = settings.url().map_err(invalid)?;
        let url = Url::parse(&url)
            .map_err(|error| invalid(format!("{url} is not an address: {error}")))?;
        let key = settings
            .key_env
            .as_deref()
            .map(ApiKey::from_environment)
            .transpose()?;
        // Descriptions are part of a run's records, where a key must not stand.
        if let (Some(key), Some(variable)) = (&key, &settings.key_env)
            && settings
                .extra
                .iter()
                .any(|(field, value)| key.is_in(field) || key.is_in(&value.to_string()))
        {
            return Err(invalid(format!(
                "extra of the description has the API key in it; remove it there, because the variable {variable} has it"
            )));
        }
        let client = Client::new(settings, url, key)?;
        let settings = if settings.model.is_empty() {
            chosen(settings, &client)?
        } else {
            settings.clone()
        };
        Ok(Self {
            name: name.to_string(),
            settings,
            client,
            probed: AtomicBool::new(false),
        })
    }
}

/// The settings with the only model of the server, and with the grammar of a server that names
/// itself and refuses what it cannot read. Others ignore a field that they do not know, so nothing
/// is sent to them.
fn chosen(settings: &EndpointSettings, client: &Client) -> Result<EndpointSettings, MllmError> {
    let models = client.models(settings)?;
    let Some(model) = models::only(&models) else {
        let offered = if models.is_empty() {
            "no model".to_owned()
        } else {
            client.named(&models)
        };
        return Err(MllmError::ChooseModel {
            endpoint: settings.endpoint.clone(),
            offered,
        });
    };
    let grammar = match (settings.grammar, model.owner.as_str()) {
        (GrammarField::None, LLAMA_CPP) => GrammarField::Gbnf,
        (grammar, _) => grammar,
    };
    Ok(EndpointSettings {
        model: model.id.clone(),
        grammar,
        ..settings.clone()
    })
}

impl Mllm for Endpoint {
    fn name(&self) -> &str {
        &self.name
    }

    fn describe(&self) -> ModelDescription {
        ModelDescription {
            name: self.name.clone(),
            architecture: "endpoint".into(),
            parameters: 0,
            dtype: String::new(),
            image_size: Some(self.settings.image_size),
            image_tokens: 0,
            vocabulary: 0,
            context: 0,
            weights_blake3: String::new(),
            load: LoadReport::default(),
            server: Some(Server {
                endpoint: self.settings.endpoint.clone(),
                model: self.settings.model.clone(),
            }),
        }
    }

    fn probe(
        &self,
        question: &ProbeQuestion,
        on_wait: &dyn Fn(&str),
    ) -> Result<Vec<String>, MllmError> {
        self.probe_once(question, on_wait)
    }

    fn converse<'a>(
        &'a self,
        prefix: &PromptPrefix,
        seed: u64,
    ) -> Result<Box<dyn Conversation + 'a>, MllmError> {
        let mut conversation = EndpointConversation {
            endpoint: self,
            system: prefix.system.clone(),
            images: Vec::new(),
            of_prefix: 0,
            seed,
            answers: 0,
            turns: Vec::new(),
        };
        conversation.show(prefix.image.as_slice())?;
        conversation.of_prefix = conversation.images.len();
        Ok(Box::new(conversation))
    }
}

/// A chat with a server. The server keeps no state, so every request carries the whole chat.
struct EndpointConversation<'a> {
    endpoint: &'a Endpoint,
    system: String,
    /// The images that prompts begin with, that of the prefix first.
    images: Vec<TurnImage>,
    /// Number of images of the prefix.
    of_prefix: usize,
    seed: u64,
    answers: u64,
    turns: Vec<Turn>,
}

impl Conversation for EndpointConversation<'_> {
    fn ask(&mut self, prompt: &str, request: &Request) -> Result<Answer, MllmError> {
        self.request(prompt, request, None)
    }

    fn ask_aloud(
        &mut self,
        prompt: &str,
        request: &Request,
        on_text: &mut dyn FnMut(&str),
    ) -> Result<Answer, MllmError> {
        if request.constraint != Constraint::Free {
            // What the server sends may wrap the answer.
            let answer = self.ask(prompt, request)?;
            on_text(&answer.text);
            return Ok(answer);
        }
        self.request(prompt, request, Some(on_text))
    }

    fn show(&mut self, images: &[Arc<RgbImage>]) -> Result<(), MllmError> {
        let turn = self.turns.len();
        let written = images.iter().map(|image| TurnImage::new(image, turn));
        self.images
            .extend(written.collect::<Result<Vec<_>, MllmError>>()?);
        Ok(())
    }

    fn mark(&self) -> Mark {
        Mark {
            turns: self.turns.len(),
            images: self.images.len() - self.of_prefix,
        }
    }

    fn rewind(&mut self, mark: Mark) {
        self.turns.truncate(mark.turns);
        self.images
            .truncate(self.of_prefix.saturating_add(mark.images));
        let next = self.turns.len();
        self.images.retain(|image| image.turn <= next);
    }
}

impl EndpointConversation<'_> {
    /// The turn of an answer that the constraint determines: nothing is left to ask.
    fn without_choice(&mut self, prompt: &str, text: &str) -> Answer {
        self.answers += 1;
        let prompt_hash = prompt_hash(&self.system, &self.turns, prompt);
        self.turns.push(Turn {
            prompt: prompt.to_owned(),
            answer: text.to_owned(),
        });
        Answer {
            text: text.to_owned(),
            ids: Vec::new(),
            log_probability: None,
            tokens: TokenCounts::default(),
            time: RoundTime::default(),
            finish: FinishReason::Complete,
            constraint: ConstraintUse::Enforced,
            prompt_hash,
        }
    }

    fn request(
        &mut self,
        prompt: &str,
        request: &Request,
        on_text: Option<&mut dyn FnMut(&str)>,
    ) -> Result<Answer, MllmError> {
        let start = Instant::now();
        let settings = &self.endpoint.settings;
        request.sampling.check()?;
        if let Constraint::Choice(texts) = &request.constraint
            && let [only] = texts.as_slice()
        {
            return Ok(self.without_choice(prompt, only));
        }
        // A question that is asked again has another seed, and may have another answer.
        let seed = answer_seed(self.seed, self.answers);
        let chat = Chat {
            system: &self.system,
            images: &self.images,
            turns: &self.turns,
            prompt,
        };
        let body = chat::body(settings, &chat, request, seed)?;
        let asked = Instant::now();
        let question = Question {
            settings,
            body: &body,
            seed,
            deadline: request.deadline,
            on_wait: &|_| (),
            may_change: &|| true,
        };
        let reply = self.endpoint.client.ask(question, on_text)?;
        let remote = milliseconds(asked.elapsed());
        let text = chat::text(settings, &request.constraint, reply.content);
        self.answers += 1;
        let prompt_hash = prompt_hash(&self.system, &self.turns, prompt);
        self.turns.push(Turn {
            prompt: prompt.to_string(),
            answer: text.clone(),
        });
        Ok(Answer {
            ids: Vec::new(),
            log_probability: None,
            tokens: reply.tokens,
            finish: reply.finish,
            constraint: chat::constraint_use(settings, &request.constraint, &text),
            prompt_hash,
            time: RoundTime {
                first_token: reply.first_text.map_or(0.0, |first| {
                    milliseconds(first.saturating_duration_since(start))
                }),
                remote,
                total: milliseconds(start.elapsed()),
                ..RoundTime::default()
            },
            text,
        })
    }
}

#[cfg(test)]
mod fake_server;
#[cfg(test)]
mod tests;
