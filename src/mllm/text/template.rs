//! The chat template of a model, which renders messages as the text that the model was trained on.

use super::template_engine::TemplateEngine;
use crate::checkpoint::{ConfigObject, ModelFiles, what_instead};
use crate::{MllmError, Turn};
use minijinja::syntax::SyntaxConfig;
use minijinja::value::Value;
use minijinja::{Environment, Error, ErrorKind, context};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

#[derive(Debug)]
pub(crate) struct ChatTemplate {
    engine: TemplateEngine,
    path: PathBuf,
    special: BTreeMap<String, String>,
    content: Content,
    /// The placeholder of an image; none in a model that reads text alone.
    image_token: Option<String>,
    /// Whether it mentions thinking.
    knows_thoughts: bool,
    /// Whether chats end where the model begins to think.
    thinks: bool,
}

/// The form of a message's content that a template accepts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Content {
    /// A list of parts, each an image or a text: multimodal templates.
    Parts,
    /// One text: templates of language models. The image placeholder goes before the text.
    Text,
}

const NAME: &str = "chat";
/// What templates of models that think mention.
const THOUGHTS: [&str; 2] = ["enable_thinking", "<think>"];

impl ChatTemplate {
    /// Opens the first of `chat_template.jinja`, and the `chat_template` of `chat_template.json`,
    /// `processor_config.json` and `tokenizer_config.json`. `special` has the special tokens by
    /// role; `image_token` is the placeholder of an image, none in a model that reads text alone.
    pub(crate) fn open(
        files: &ModelFiles,
        special: &BTreeMap<String, String>,
        image_token: Option<&str>,
    ) -> Result<Self, MllmError> {
        let (path, source) = find_source(files)?;
        let engine = compiled(&source).map_err(|error| failure(&path, &error))?;
        let mut template = Self {
            engine,
            path,
            special: special.clone(),
            content: Content::Parts,
            image_token: image_token.map(str::to_owned),
            knows_thoughts: THOUGHTS.into_iter().any(|word| source.contains(word)),
            thinks: false,
        };
        template.content = template.accepted_content()?;
        Ok(template)
    }

    /// From now on, chats end where the model begins to think.
    ///
    /// # Errors
    /// When the template knows no thinking.
    pub(crate) fn let_think(&mut self) -> Result<(), MllmError> {
        if !self.knows_thoughts {
            return Err(MllmError::ChatTemplate {
                path: self.path.clone(),
                problem: format!(
                    "generation.thinking: the template has neither {}, so the model was not trained to think",
                    THOUGHTS.join(" nor ")
                ),
            });
        }
        self.thinks = true;
        Ok(())
    }

    /// Renders a chat that ends with `prompt` and the beginning of the model's answer. `images` has
    /// the turn of each image, from 0.
    pub(crate) fn render(
        &self,
        system: &str,
        images: &[usize],
        turns: &[Turn],
        prompt: &str,
    ) -> Result<String, MllmError> {
        self.render_as(self.content, system, images, turns, prompt)
            .map_err(|error| failure(&self.path, &error))
    }

    fn render_as(
        &self,
        content: Content,
        system: &str,
        images: &[usize],
        turns: &[Turn],
        prompt: &str,
    ) -> Result<String, Error> {
        let mut messages = Vec::with_capacity(2 * turns.len() + 2);
        let mut say = |role: &str, images, text: &str| {
            messages.push(context! { role, content => self.content(content, images, text) });
        };
        let of_turn = |index: usize| images.iter().filter(|turn| **turn == index).count();
        if !system.is_empty() {
            say("system", 0, system);
        }
        for (index, turn) in turns.iter().enumerate() {
            say("user", of_turn(index), &turn.prompt);
            // An answer with the placeholder's name must not add an image to the chat.
            let answer = match &self.image_token {
                Some(token) => turn.answer.replace(token, ""),
                None => turn.answer.clone(),
            };
            say("assistant", 0, &answer);
        }
        say("user", of_turn(turns.len()), prompt);
        let special = Value::from_pairs(
            self.special
                .iter()
                .map(|(role, token)| (role.as_str(), token.as_str())),
        );
        // Unless a description wants thinking, an answer begins at once.
        let chat = context! {
            messages, add_generation_prompt => true, enable_thinking => self.thinks, ..special
        };
        let texts = turns
            .iter()
            .map(|turn| turn.prompt.len() + turn.answer.len());
        let bytes = system.len() + prompt.len() + texts.sum::<usize>();
        self.engine.render(NAME, chat, bytes)
    }

    fn content(&self, content: Content, images: usize, text: &str) -> Value {
        match content {
            Content::Parts => {
                let images = (0..images).map(|_| context! { type => "image" });
                let text = context! { type => "text", text };
                Value::from(images.chain([text]).collect::<Vec<_>>())
            }
            Content::Text => {
                let token = self.image_token.as_ref();
                let mark = token.map_or_else(String::new, |token| format!("{token}\n"));
                Value::from(mark.repeat(images) + text)
            }
        }
    }

    /// Finds the form of content that the template renders: parts first with an image, texts first
    /// without one, as transformers calls it.
    fn accepted_content(&self) -> Result<Content, MllmError> {
        const PROBE: &str = "probe";
        let sees = self.image_token.is_some();
        let with = if sees { "an image and " } else { "" };
        let images = |text: &str| {
            let token = self.image_token.as_ref();
            token.map_or(0, |token| text.matches(token).count())
        };
        let forms = if sees {
            [Content::Parts, Content::Text]
        } else {
            [Content::Text, Content::Parts]
        };
        let mut last = None;
        for content in forms {
            let shown: &[usize] = if sees { &[0] } else { &[] };
            match self.render_as(content, "", shown, &[], PROBE) {
                // A template for texts can print the list itself, so the output must not contain
                // the keys of the parts.
                Ok(text)
                    if images(&text) == usize::from(sees)
                        && text.contains(PROBE)
                        && !text.contains("\"type\"") =>
                {
                    return Ok(content);
                }
                Ok(text) => {
                    last = Some(format!(
                        "a message with {with}the text '{PROBE}' renders as '{}'",
                        text.escape_debug()
                    ));
                }
                Err(error) => last = Some(describe(&error)),
            }
        }
        Err(MllmError::ChatTemplate {
            path: self.path.clone(),
            problem: last.expect("one form of content at least was tried"),
        })
    }
}

/// The template of a source within the bounds.
fn compiled(source: &str) -> Result<TemplateEngine, Error> {
    let mut engine = TemplateEngine::of_chats(environment()?);
    engine.add(NAME, without_generation_tags(source))?;
    Ok(engine)
}

/// The template engine, set up as in transformers.
fn environment() -> Result<Environment<'static>, Error> {
    let mut environment = Environment::new();
    environment.set_syntax(
        SyntaxConfig::builder()
            .trim_blocks(true)
            .lstrip_blocks(true)
            .build()?,
    );
    environment.set_unknown_method_callback(minijinja_contrib::pycompat::unknown_method_callback);
    environment.add_function("raise_exception", |message: String| {
        Err::<Value, Error>(Error::new(ErrorKind::InvalidOperation, message))
    });
    environment.add_function("strftime_now", |format: String| fixed_date(&format));
    Ok(environment)
}

/// `strftime_now` of chat templates. The same chat must give the same prompt every day, so the date
/// is always that of Llama 3's template: 26 July 2024, 00:00:00.
fn fixed_date(format: &str) -> Result<String, Error> {
    jiff::fmt::strtime::format(format, jiff::civil::date(2024, 7, 26).at(0, 0, 0, 0)).map_err(
        |error| {
            Error::new(
                ErrorKind::InvalidOperation,
                format!("strftime_now: {error}"),
            )
        },
    )
}

/// The `chat_template` of a configuration.
#[derive(Deserialize)]
#[serde(untagged, expecting = "expected a text, or templates with names")]
enum Templates {
    One(String),
    Named(Vec<NamedTemplate>),
    ByName(BTreeMap<String, String>),
}

#[derive(Deserialize)]
struct NamedTemplate {
    name: String,
    template: String,
}

/// The source of the template and its file.
fn find_source(files: &ModelFiles) -> Result<(PathBuf, String), MllmError> {
    const NAME: &str = "chat_template.jinja";
    if let Some(source) = files.text(NAME)? {
        let path = files.path(NAME);
        return match web_page_of(&source) {
            None => Ok((path, source)),
            Some(problem) => Err(MllmError::ChatTemplate { path, problem }),
        };
    }
    // Newer places first; older models keep the template in the last of these.
    for file in [
        "chat_template.json",
        "processor_config.json",
        "tokenizer_config.json",
    ] {
        let Some(value) = files.json(file)? else {
            continue;
        };
        let path = files.path(file);
        let root = ConfigObject::root(&path, &value)?;
        let source = match root.value("chat_template")? {
            None => continue,
            Some(Templates::One(source)) => Some(source),
            Some(Templates::Named(named)) => {
                let default = named.into_iter().find(|entry| entry.name == "default");
                default.map(|entry| entry.template)
            }
            Some(Templates::ByName(mut named)) => named.remove("default"),
        };
        let source =
            source.ok_or_else(|| root.error("chat_template", "has no template named default"))?;
        return Ok((path, source));
    }
    Err(files.missing(
        "chat_template.jinja (nor a chat_template in chat_template.json, processor_config.json or tokenizer_config.json)",
    ))
}

/// What a text is that begins as a page of the web does, which no template does.
fn web_page_of(source: &str) -> Option<String> {
    let beginning: String = source.trim_start().chars().take(9).collect();
    let beginning = beginning.to_ascii_lowercase();
    ["<!doctype", "<html", "<?xml"]
        .iter()
        .any(|page| beginning.starts_with(page))
        .then(|| what_instead(source.as_bytes()))
        .flatten()
}

/// The source of a model's chat template; none where it has none.
pub(crate) fn template_source(files: &ModelFiles) -> Result<Option<String>, MllmError> {
    match find_source(files) {
        Ok((_, source)) => Ok(Some(source)),
        Err(MllmError::MissingFile { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Replaces `{% generation %}`, which marks the model's text for training, by a block without
/// effect.
fn without_generation_tags(source: &str) -> String {
    let mut out = String::with_capacity(source.len());
    let mut rest = source;
    while let Some(begin) = rest.find("{%") {
        let (before, tag) = rest.split_at(begin);
        out.push_str(before);
        let Some(end) = tag.find("%}") else {
            rest = tag;
            break;
        };
        let (tag, after) = tag.split_at(end + 2);
        match tag
            .trim_start_matches(['{', '%', '-', '+'])
            .trim_end_matches(['}', '%', '-', '+'])
            .trim()
        {
            "generation" => out.push_str(&tag.replacen("generation", "if true", 1)),
            "endgeneration" => out.push_str(&tag.replacen("endgeneration", "endif", 1)),
            _ => out.push_str(tag),
        }
        rest = after;
    }
    out.push_str(rest);
    out
}

fn failure(path: &Path, error: &Error) -> MllmError {
    MllmError::ChatTemplate {
        path: path.to_path_buf(),
        problem: describe(error),
    }
}

fn describe(error: &Error) -> String {
    let line = error
        .line()
        .map_or_else(String::new, |line| format!("line {line}: "));
    let detail = error
        .detail()
        .map_or_else(|| error.kind().to_string(), ToString::to_string);
    format!("{line}{detail}")
}

#[cfg(test)]
mod tests {
    use super::super::template_bounds::MAX_SOURCE_BYTES;
    use super::*;

    fn open(source: &str) -> Result<ChatTemplate, MllmError> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("chat_template.jinja"), source).unwrap();
        let special = BTreeMap::from([("bos_token".to_string(), "<s>".to_string())]);
        ChatTemplate::open(
            &ModelFiles::folder(folder.path()).unwrap(),
            &special,
            Some("<image>"),
        )
    }

    const LLAVA: &str = "{% for message in messages %}{% if message['role'] != 'system' %}{{ message['role'].upper() + ': '}}{% endif %}{% for content in message['content'] | selectattr('type', 'equalto', 'image') %}{{ '<image>\\n' }}{% endfor %}{% for content in message['content'] | selectattr('type', 'equalto', 'text') %}{% generation %}{{ content['text'] + ' '}}{% endgeneration %}{% endfor %}{% endfor %}{% if add_generation_prompt %}{{ 'ASSISTANT:' }}{% endif %}";

    #[test]
    fn a_llava_template_renders_parts() {
        let template = open(LLAVA).unwrap();
        let turns = [Turn {
            prompt: "one".into(),
            answer: "two".into(),
        }];
        assert_eq!(
            template.render("Drive.", &[0], &turns, "three").unwrap(),
            "Drive. USER: <image>\none ASSISTANT: two USER: three ASSISTANT:"
        );
        assert_eq!(
            template.render("", &[], &[], "one").unwrap(),
            "USER: one ASSISTANT:"
        );
        assert_eq!(
            template.render("", &[0, 1, 1], &turns, "three").unwrap(),
            "USER: <image>\none ASSISTANT: two USER: <image>\n<image>\nthree ASSISTANT:"
        );
    }

    #[test]
    fn loops_are_controlled_as_in_transformers() {
        let template = open(
            "{% for m in messages %}{% if m.role == 'system' %}{% continue %}{% endif %}{{ m.content }};\
             {% if loop.index > 2 %}{% break %}{% endif %}{% endfor %}",
        )
        .unwrap();
        let turns = ["a", "c"].map(|text| Turn {
            prompt: text.into(),
            answer: "b".into(),
        });
        assert_eq!(template.render("s", &[], &turns, "d").unwrap(), "a;b;");
        assert!(open("{% break %}").is_err());
    }

    #[test]
    fn a_template_of_a_language_model_gets_texts() {
        let template =
            open("{{ bos_token }}{% for m in messages %}[{{ m.role }}] {{ m.content | trim }}\n{% endfor %}").unwrap();
        assert_eq!(
            template.render("s", &[0], &[], "hello ").unwrap(),
            "<s>[system] s\n[user] <image>\nhello\n"
        );
        assert_eq!(
            template.render("", &[0, 0], &[], "hello").unwrap(),
            "<s>[user] <image>\n<image>\nhello\n"
        );
    }

    #[test]
    fn the_date_is_always_the_same() {
        assert_eq!(fixed_date("%d %b %Y, 100%%").unwrap(), "26 Jul 2024, 100%");
        assert_eq!(
            fixed_date("%y %m %B %h %A %a %j %H:%M:%S %I %p %F %T").unwrap(),
            FIXED_DATE
        );
        assert!(fixed_date("%Z").is_err());
        assert!(fixed_date("%").is_err());
    }

    const FIXED_DATE: &str = "24 07 July Jul Friday Fri 208 00:00:00 12 AM 2024-07-26 00:00:00";

    /// None of these ends by itself, or fits the stack of a thread.
    #[test]
    fn hostile_templates_are_errors() {
        let nest = |begin: &str, part: &str, end: &str| {
            let count = (MAX_SOURCE_BYTES - begin.len() - end.len()) / part.len();
            format!("{begin}{}{end}", part.repeat(count))
        };
        for source in [
            nest("{{ ", "not ", "true }}"),
            nest("{{ ", "-", "1 }}"),
            nest("{{ 1", "+1", " }}"),
            nest("{{ 1", "~1", " }}"),
            nest("{{ a", ".a", " }}"),
            nest("{{ a", "[0]", " }}"),
            nest("{{ a", "()", " }}"),
            nest("{{ a", "|e", " }}"),
            nest("{{ 1", " and 1", " }}"),
            nest("{{ 1", " is odd", " }}"),
            nest("{{ ", "1 if 1 else ", "1 }}"),
            nest("{{ ", "[", " }}"),
            nest("", "{% if 1 %}", ""),
            "{% for a in range(99999) %}{% for b in range(99999) %}{% endfor %}{% endfor %}probe<image>".to_owned(),
            "{% for a in range(99999) %}0123456789{% endfor %}probe<image>".to_owned(),
            // A loop that is left ends the inner one alone.
            "{% for a in range(99999) %}{% for b in range(99999) %}{% if b > 90 %}{% break %}{% endif %}{% endfor %}{% endfor %}\
             probe<image>"
                .to_owned(),
            "{% for a in range(99999) %}{% for b in range(99999) %}{% continue %}{% endfor %}{% endfor %}probe<image>"
                .to_owned(),
            "{% macro m() %}{{ m() }}{% endmacro %}{{ m() }}probe<image>".to_owned(),
            "{% set n = namespace(x=[]) %}{% for i in range(60000) %}{% set n.x = [n.x] %}{% endfor %}{{ n.x }}"
                .to_owned(),
            format!("{}probe<image>", " ".repeat(MAX_SOURCE_BYTES)),
        ] {
            let shown: String = source.chars().take(60).collect();
            match open(&source) {
                Err(MllmError::ChatTemplate { problem, .. }) => assert!(problem.len() < 1 << 20, "{shown}"),
                other => panic!("{shown}: {other:?}"),
            }
        }
        let tag = open(&nest("{{ x", "+1", " }}")).unwrap_err();
        assert!(tag.to_string().contains("a tag has"), "{tag}");
        let steps =
            open("{% for a in range(99999) %}{% for b in range(99999) %}{% endfor %}{% endfor %}")
                .unwrap_err();
        assert!(
            steps.to_string().contains("more than 500000 steps"),
            "{steps}"
        );
        for left in [
            "{% break %}",
            "{% if b > 90 %}{% break %}{% endif %}{% continue %}",
        ] {
            let hostile = format!(
                "{{% for a in range(99999) %}}{{% for b in range(99999) %}}{left}{{% endfor %}}{{% for c in range(99) %}}{{% endfor %}}{{% endfor %}}"
            );
            let steps = open(&hostile).unwrap_err().to_string();
            assert!(steps.contains("more than 500000 steps"), "{left}: {steps}");
        }
        let long = open("{% for a in range(99999) %}0123456789{% endfor %}").unwrap_err();
        assert!(
            long.to_string().contains("the rendered text has more than"),
            "{long}"
        );
    }

    #[test]
    fn broken_and_refusing_templates_are_errors() {
        for (source, expected) in [
            ("{% for %}", "line 1"),
            ("{{ raise_exception('no images') }}", "no images"),
            ("constant", "probe"),
            ("{{ messages[0].content[0].nothing.at_all }}", "undefined"),
        ] {
            match open(source) {
                Err(MllmError::ChatTemplate { problem, .. }) => {
                    assert!(problem.contains(expected), "{source}: {problem}");
                }
                other => panic!("{source}: {other:?}"),
            }
        }
    }
}
