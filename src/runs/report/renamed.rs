//! Settings that have another name than in run folders of before. Their manifests are read with
//! the names of now. The digest of a run counts the names of before, so that a study finds the runs
//! that an earlier version made.

use serde::{Deserialize, Deserializer};
use toml::{Table, Value};

/// The section that the intervals were in, and the one that they are in.
const SECTIONS: [&str; 2] = ["reasoning", "agent"];
/// An interval's name when it counted iterations, and its name in seconds.
const INTERVALS: [[&str; 2]; 2] = [
    ["interval", "interval_s"],
    ["blocked_interval", "blocked_interval_s"],
];
/// Iterations of a second. A quotient of it is the nearest number to its decimal fraction, which a
/// product with 0.1 is not: 30 iterations are 3.0 s.
const ITERATIONS_PER_SECOND: f64 = 10.0;

/// A setting by a name that it no longer has.
#[derive(Debug, Clone, PartialEq)]
pub struct RenamedSetting {
    /// The section that it was in.
    pub section: &'static str,
    /// Its name of before.
    pub name: &'static str,
    /// Its dotted key of now.
    now: String,
    /// Its value of now; `None` where the old one makes no sense.
    value: Option<f64>,
}

impl RenamedSetting {
    /// Those that a configuration names.
    pub fn all_in(config: &Table) -> Vec<Self> {
        let [section, section_now] = SECTIONS;
        let old = |name: &str| config.get(section)?.get(name);
        INTERVALS
            .iter()
            .filter_map(|[name, now]| {
                Some(Self {
                    section,
                    name,
                    now: format!("{section_now}.{now}"),
                    value: old(name)?.as_integer().map(seconds),
                })
            })
            .collect()
    }
}

impl std::fmt::Display for RenamedSetting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            section, name, now, ..
        } = self;
        write!(f, "{section}.{name} is {now} now, in seconds; write ")?;
        match self.value {
            Some(value) => write!(f, "{now} = {value:?}"),
            None => write!(f, "{now} = SECONDS"),
        }
    }
}

/// Reads the configuration of a manifest with the names of now.
pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Table, D::Error> {
    let mut config = Table::deserialize(deserializer)?;
    move_settings(&mut config, SECTIONS, INTERVALS, |value| {
        value.as_integer().map(seconds).map(Value::Float)
    });
    Ok(config)
}

/// A configuration with the names of before.
pub(super) fn with_names_of_before(config: &Table) -> Table {
    let mut config = config.clone();
    let ([before, now], names) = (SECTIONS, INTERVALS.map(|[before, now]| [now, before]));
    move_settings(&mut config, [now, before], names, |value| {
        let iterations = (value.as_float()? * ITERATIONS_PER_SECOND).round();
        Some(Value::Integer(iterations as i64))
    });
    config
}

fn seconds(iterations: i64) -> f64 {
    iterations as f64 / ITERATIONS_PER_SECOND
}

/// Moves settings to another section under other names. One that cannot be converted stays.
fn move_settings(
    config: &mut Table,
    [from, to]: [&str; 2],
    names: [[&str; 2]; 2],
    converted: impl Fn(&Value) -> Option<Value>,
) {
    for [name, other_name] in names {
        let section = config.get_mut(from).and_then(Value::as_table_mut);
        let Some(section) = section else {
            return;
        };
        let Some(value) = section.get(name).and_then(&converted) else {
            continue;
        };
        section.remove(name);
        let target = config
            .entry(to)
            .or_insert_with(|| Value::Table(Table::new()));
        if let Some(target) = target.as_table_mut() {
            target.insert(other_name.to_owned(), value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Deserialize)]
    struct Stored {
        #[serde(deserialize_with = "deserialize")]
        config: Table,
    }

    fn read(config: &str) -> Table {
        toml::from_str::<Stored>(config).unwrap().config
    }

    #[test]
    fn an_old_configuration_is_read_in_seconds_and_counts_as_before() {
        let old = "config.agent.latency = 'none'\n\
            config.reasoning = { interval = 30, blocked_interval = 7, grammar = true }";
        let new = read(old);
        let expected = "[agent]\nlatency = 'none'\ninterval_s = 3.0\nblocked_interval_s = 0.7\n\
            [reasoning]\ngrammar = true";
        assert_eq!(new, expected.parse().unwrap());
        let before = old.parse::<Table>().unwrap().remove("config").unwrap();
        assert_eq!(
            with_names_of_before(&new),
            *before.as_table().unwrap(),
            "the digest counts what it counted"
        );
    }

    #[test]
    fn a_configuration_of_now_or_without_sections_stays() {
        for text in [
            "seed = 1",
            "agent = { interval_s = 2.0 }\nreasoning = { grammar = true }",
            "reasoning = { interval = 'often' }",
            "reasoning = 3",
        ] {
            let config: Table = text.parse().unwrap();
            let mut stored = Table::new();
            stored.insert("config".to_owned(), Value::Table(config.clone()));
            assert_eq!(read(&toml::to_string(&stored).unwrap()), config, "{text}");
        }
    }

    #[test]
    fn an_old_name_is_found_with_the_value_to_write() {
        let found = |text: &str| -> Vec<String> {
            let all = RenamedSetting::all_in(&text.parse().unwrap());
            all.iter().map(ToString::to_string).collect()
        };
        assert_eq!(
            found("reasoning = { interval = 20, blocked_interval = 'x' }"),
            [
                "reasoning.interval is agent.interval_s now, in seconds; write agent.interval_s = 2.0",
                "reasoning.blocked_interval is agent.blocked_interval_s now, in seconds; \
                 write agent.blocked_interval_s = SECONDS",
            ]
        );
        assert!(found("reasoning = { grammar = true }\nagent = { interval_s = 2.0 }").is_empty());
    }
}
