//! The engine of all templates that may come from elsewhere: chat templates of models, and prompt
//! sets. Reading and rendering end: sizes, steps and lengths have bounds.

use super::prompt_rules;
use super::template_bounds::{
    BoundedText, MAX_CALLS, MAX_SOURCE_BYTES, MAX_STEPS, MAX_TAG_BYTES, longest_tag, on_deep_stack,
};
use minijinja::value::Value;
use minijinja::{Environment, Error, ErrorKind, UndefinedBehavior};
use std::collections::BTreeSet;

/// Templates with their bounds.
#[derive(Debug)]
pub struct TemplateEngine {
    environment: Environment<'static>,
    /// Instructions of one rendering.
    max_steps: u64,
    /// What the source of a template may hold.
    rules: fn(&str) -> Result<(), String>,
}

impl TemplateEngine {
    /// An engine of chat templates, which `environment` sets up. Their values have no bound in this
    /// process; a trial in a child process comes first.
    pub(super) fn of_chats(mut environment: Environment<'static>) -> Self {
        environment.set_fuel(Some(MAX_STEPS));
        environment.set_recursion_limit(MAX_CALLS);
        Self {
            environment,
            max_steps: MAX_STEPS,
            rules: |_| Ok(()),
        }
    }

    /// An engine of prompt sets. A template that names a missing value cannot be rendered. The
    /// language is a part of Jinja in which no value grows beyond a bound.
    pub fn of_prompts() -> Self {
        let mut environment = prompt_rules::environment();
        environment.set_undefined_behavior(UndefinedBehavior::Strict);
        environment.set_fuel(Some(prompt_rules::MAX_STEPS));
        environment.set_recursion_limit(MAX_CALLS);
        Self {
            environment,
            max_steps: prompt_rules::MAX_STEPS,
            rules: prompt_rules::check,
        }
    }

    /// Adds a template.
    ///
    /// # Errors
    /// When it is no template, or beyond the bounds.
    pub fn add(&mut self, name: &'static str, source: String) -> Result<(), Error> {
        if source.len() > MAX_SOURCE_BYTES {
            return Err(refused(format!(
                "it has {} bytes; at most {MAX_SOURCE_BYTES} are read",
                source.len()
            )));
        }
        let tag = longest_tag(&source);
        if tag > MAX_TAG_BYTES {
            return Err(refused(format!(
                "a tag has {tag} bytes of code; at most {MAX_TAG_BYTES} are read"
            )));
        }
        (self.rules)(&source).map_err(refused)?;
        let environment = &mut self.environment;
        on_deep_stack(move || environment.add_template_owned(name, source))
            .map_err(|error| refused(error.to_string()))?
    }

    /// The values that a template takes from its context, as `name` or `name.field`.
    ///
    /// # Errors
    /// When there is no such template.
    pub fn variables(&self, name: &str) -> Result<BTreeSet<String>, Error> {
        let template = self.environment.get_template(name)?;
        let globals: BTreeSet<String> = self
            .environment
            .globals()
            .map(|(global, _)| global.to_owned())
            .collect();
        Ok(template
            .undeclared_variables(true)
            .into_iter()
            .filter(|variable| !globals.contains(variable))
            .collect())
    }

    /// The text of a template. Without the texts of `context`, which have `bytes` bytes and may
    /// occur a few times, it has a bound.
    ///
    /// # Errors
    /// When it cannot be rendered within the bounds.
    pub fn render(&self, name: &str, context: Value, bytes: usize) -> Result<String, Error> {
        let mut text = BoundedText::of_texts(bytes);
        let template = self.environment.get_template(name)?;
        let rendered = on_deep_stack(|| template.render_captured_to(context, &mut text).map(drop))
            .map_err(|error| refused(error.to_string()))?;
        match text.into_text() {
            Ok(text) => rendered.map(|()| text).map_err(|error| self.told(error)),
            Err(problem) => Err(refused(problem)),
        }
    }

    /// An error that says how many steps were too many.
    fn told(&self, error: Error) -> Error {
        if error.kind() != ErrorKind::OutOfFuel {
            return error;
        }
        let line = error
            .line()
            .map_or_else(String::new, |line| format!("line {line}: "));
        refused(format!("{line}it takes more than {} steps", self.max_steps))
    }
}

fn refused(problem: String) -> Error {
    Error::new(ErrorKind::InvalidOperation, problem)
}

#[cfg(test)]
mod tests {
    use super::*;
    use minijinja::context;

    /// The text of a template of a prompt set, or why there is none.
    fn rendered(source: &str) -> Result<String, String> {
        let mut engine = TemplateEngine::of_prompts();
        engine
            .add("t", source.to_owned())
            .and_then(|()| {
                let values = context! {
                    x => "x".repeat(20_000), names => ["a", "b"], parts => [("c", 1.5), ("d", 2.0)],
                    nothing => Value::from(()),
                };
                engine.render("t", values, 0)
            })
            .map_err(|error| format!("{error:#}"))
    }

    #[test]
    fn prompts_loop_choose_and_join() {
        for (source, text) in [
            ("{{ names | join(', ') }}", "a, b"),
            ("{{ (names + ['None']) | join(\"; \") }}", "a; b; None"),
            ("{{ [1, 2.5, true] | join }}", "12.5True"),
            (
                "{% for n, v in parts if v | float < 1.9 %}{{ n }}={{ v }}{% endfor %}",
                "c=1.5",
            ),
            (
                "{%- if nothing is none +%} no{% else %}yes{% endif %}",
                " no",
            ),
            ("{% set a = names[0] | upper ~ '!' %}{{ a }}", "A!"),
            (
                "{{ 'a-b' | replace('-', '+') }} {{ 'é' | length }}",
                "a+b 1",
            ),
            ("{# {% macro m() %} #}{{ '{% macro %}' }}", "{% macro %}"),
        ] {
            assert_eq!(rendered(source).as_deref(), Ok(text), "{source}");
        }
        assert!(rendered("{{ missing }}").unwrap_err().contains("undefined"));
    }

    #[test]
    fn hostile_prompts_are_errors_in_time_and_memory() {
        let loops = "{% for i in range(10000) %}".repeat(3) + &"{% endfor %}".repeat(3);
        let doubled = "{% set x = x ~ x %}".repeat(40) + "{{ x | length }}";
        let begins: Vec<String> = (0..12)
            .map(|i| format!("{{% for a{i} in [[x, x, x]] %}}"))
            .collect();
        let nested = begins.concat() + &"{% endfor %}".repeat(12);
        let long = "{{ x }}".repeat(4000);
        for (source, problem) in [
            (loops.as_str(), "steps"),
            (
                "{% set a = 'x' * 1000000 %}{{ a | replace('x', a) | length }}",
                "multiply",
            ),
            ("{{ 10 ** 10 }}", "multiply"),
            (&doubled, "of ~, + and commas"),
            (&nested, "of ~, + and commas"),
            (&long, "more than"),
            ("{{ x | replace('x', x) }}", "bytes"),
            ("{{ x | list | join(x) }}", "bytes"),
            ("{{ [x, x, x, x] | string }}", "bytes"),
            ("{% set n = namespace(a=1) %}{{ n.a }}", "namespace"),
            ("{% macro m() %}{{ m() }}{% endmacro %}{{ m() }}", "macro"),
            ("{% call m() %}{% endcall %}", "call"),
            ("{% set a %}{{ x }}{% endset %}", "set"),
            ("{% filter upper %}a{% endfilter %}", "filter"),
            (
                "{% for i in names recursive %}{{ loop(names) }}{% endfor %}",
                "recursive",
            ),
            ("{% include 't' %}", "include"),
            ("{% raw %}{{ \"{% endraw %}{% macro m() %}", "raw"),
            ("{{ '%99999999d' | format(1) }}", "format"),
            ("{{ x | tojson }}", "tojson"),
            ("{{ x.replace('x', x) }}", "method"),
            ("{{ debug() }}", "debug"),
        ] {
            let shown: String = source.chars().take(60).collect();
            let error = rendered(source).expect_err(&shown);
            assert!(error.contains(problem), "{shown}: {error}");
        }
    }
}
