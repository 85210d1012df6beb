//! Names of interPlan's scenes: a token and pairs of a letter and a value (interPlan
//! `scenario_utils.py`).

use super::density::Density;
use planagent_world::{DriverBehavior, InteractionKind};
use std::fmt;

/// What is wrong with a name. interPlan raises `IndexError`, `KeyError` and `ValueError`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub(crate) enum NameFault {
    #[error("the letter '{0}' has no value behind it")]
    NoValue(char),
    #[error("the letter '{0}' is none of a, d, g, o, s")]
    UnknownLetter(char),
    #[error("the amount of agents '{0}' is not a digit")]
    Amount(char),
    #[error("the {what} '{value}' is none of {known}")]
    UnknownValue {
        what: &'static str,
        value: char,
        known: &'static str,
    },
}

/// Where the route turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Command {
    Left,
    Straight,
    Right,
}

/// How other drivers behave.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Observation {
    Assertive,
    Cautious,
    Mixed,
}

impl From<Observation> for DriverBehavior {
    fn from(observation: Observation) -> Self {
        match observation {
            Observation::Assertive => Self::Assertive,
            Observation::Cautious => Self::Cautious,
            Observation::Mixed => Self::Mixed,
        }
    }
}

/// A name behind its token. Values are as written: interPlan does not check them where it reads
/// them.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(crate) struct InterPlanName {
    pub(super) amount: Option<u8>,
    pub(super) density: Option<char>,
    pub(super) goal: Option<char>,
    pub(super) observation: Option<char>,
    pub(super) special: Option<String>,
}

impl InterPlanName {
    /// Reads the pairs; a later one replaces an earlier one.
    ///
    /// # Errors
    /// When a letter is unknown or lacks its value.
    pub(crate) fn parse(text: &str) -> Result<Self, NameFault> {
        let chars: Vec<char> = text.chars().collect();
        let mut name = Self::default();
        let mut at = 0;
        while let Some(&letter) = chars.get(at) {
            let Some(&value) = chars.get(at + 1) else {
                return Err(NameFault::NoValue(letter));
            };
            at += 2;
            match letter {
                'a' => {
                    let digit = value
                        .to_digit(10)
                        .and_then(|digit| u8::try_from(digit).ok());
                    name.amount = Some(digit.ok_or(NameFault::Amount(value))?);
                }
                'd' => name.density = Some(value),
                'g' => name.goal = Some(value),
                'o' => name.observation = Some(value),
                's' => {
                    let mut number = value.to_string();
                    // A special scene's number has one digit or two, and nothing marks its end.
                    if let Some(second) = chars.get(at).filter(|second| second.is_ascii_digit()) {
                        number.push(*second);
                        at += 1;
                    }
                    name.special = Some(number);
                }
                other => return Err(NameFault::UnknownLetter(other)),
            }
        }
        Ok(name)
    }

    /// Whether it changes the agents.
    #[cfg(test)]
    pub(crate) fn changes_agents(&self) -> bool {
        self.amount.is_some() || self.density.is_some() || self.special.is_some()
    }

    /// The density of the traffic.
    ///
    /// # Errors
    /// When it is none of interPlan's.
    pub(crate) fn density(&self) -> Result<Option<Density>, NameFault> {
        let known = |value| match value {
            'l' => Ok(Density::Low),
            'm' => Ok(Density::Medium),
            'h' => Ok(Density::High),
            _ => Err(NameFault::UnknownValue {
                what: "density",
                value,
                known: "l, m, h",
            }),
        };
        self.density.map(known).transpose()
    }

    /// Where the route turns.
    ///
    /// # Errors
    /// When it is none of interPlan's.
    pub(crate) fn goal(&self) -> Result<Option<Command>, NameFault> {
        let known = |value| match value {
            'l' => Ok(Command::Left),
            's' => Ok(Command::Straight),
            'r' => Ok(Command::Right),
            _ => Err(NameFault::UnknownValue {
                what: "goal",
                value,
                known: "l, r, s",
            }),
        };
        self.goal.map(known).transpose()
    }

    /// How other drivers behave. Without a word, interPlan takes that of the scene before; here it
    /// is assertive, interPlan's first.
    ///
    /// # Errors
    /// When it is none of interPlan's.
    pub(crate) fn observation(&self) -> Result<Observation, NameFault> {
        match self.observation {
            None | Some('a') => Ok(Observation::Assertive),
            Some('c') => Ok(Observation::Cautious),
            Some('m') => Ok(Observation::Mixed),
            Some(value) => Err(NameFault::UnknownValue {
                what: "observation",
                value,
                known: "a, c, m",
            }),
        }
    }

    /// The number of a special scene.
    pub(crate) fn special(&self) -> Option<&str> {
        self.special.as_deref()
    }

    /// The kind of a scene of traffic.
    pub(crate) fn kind(&self) -> Option<InteractionKind> {
        match self.density {
            Some('l') => Some(InteractionKind::LowTrafficDensity),
            Some('m') => Some(InteractionKind::MediumTrafficDensity),
            Some('h') => Some(InteractionKind::HighTrafficDensity),
            _ => None,
        }
    }
}

/// As interPlan writes it back: a special scene alone, else all pairs in its order.
impl fmt::Display for InterPlanName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(special) = &self.special {
            return write!(f, "s{special}");
        }
        if let Some(amount) = self.amount {
            write!(f, "a{amount}")?;
        }
        for (letter, value) in [
            ('d', self.density),
            ('g', self.goal),
            ('o', self.observation),
        ] {
            if let Some(value) = value {
                write!(f, "{letter}{value}")?;
            }
        }
        Ok(())
    }
}
