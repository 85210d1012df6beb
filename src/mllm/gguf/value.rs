//! Values of GGUF metadata.

use std::fmt;

/// A value of GGUF metadata; integers of all widths are one type.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// An unsigned integer.
    Unsigned(u64),
    /// A signed integer.
    Signed(i64),
    /// A float of 32 bits.
    Float(f32),
    /// A float of 64 bits.
    Double(f64),
    /// A truth value.
    Bool(bool),
    /// A text.
    Text(String),
    /// A list of integers or truth values.
    Integers(Vec<i64>),
    /// A list of floats.
    Floats(Vec<f32>),
    /// A list of texts.
    Texts(Vec<String>),
    /// A list of anything else.
    List(Vec<Value>),
}

impl Value {
    /// A whole number that is not negative.
    pub(crate) fn as_u64(&self) -> Option<u64> {
        match self {
            Self::Unsigned(number) => Some(*number),
            Self::Signed(number) => u64::try_from(*number).ok(),
            _ => None,
        }
    }

    /// A whole number, or a truth value as 0 or 1.
    pub(crate) fn as_i64(&self) -> Option<i64> {
        match self {
            Self::Unsigned(number) => i64::try_from(*number).ok(),
            Self::Signed(number) => Some(*number),
            Self::Bool(truth) => Some(i64::from(*truth)),
            _ => None,
        }
    }

    /// A number.
    pub(crate) fn as_f64(&self) -> Option<f64> {
        match self {
            Self::Float(number) => Some(f64::from(*number)),
            Self::Double(number) => Some(*number),
            Self::Unsigned(number) => Some(*number as f64),
            Self::Signed(number) => Some(*number as f64),
            _ => None,
        }
    }
}

/// For messages: a list by its length, a long text by its beginning.
impl fmt::Display for Value {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        const SHOWN: usize = 60;
        match self {
            Self::Unsigned(number) => write!(out, "{number}"),
            Self::Signed(number) => write!(out, "{number}"),
            Self::Float(number) => write!(out, "{number}"),
            Self::Double(number) => write!(out, "{number}"),
            Self::Bool(truth) => write!(out, "{truth}"),
            Self::Text(text) => write!(out, "{:?}", text.chars().take(SHOWN).collect::<String>()),
            Self::Integers(list) => write!(out, "a list of {} integers", list.len()),
            Self::Floats(list) => write!(out, "a list of {} numbers", list.len()),
            Self::Texts(list) => write!(out, "a list of {} texts", list.len()),
            Self::List(list) => write!(out, "a list of {} values", list.len()),
        }
    }
}
