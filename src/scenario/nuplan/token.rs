//! Names of rows: 8 bytes in a log, 16 hexadecimal digits elsewhere.

use rusqlite::ToSql;
use rusqlite::types::{ToSqlOutput, ValueRef};
use std::fmt;
use std::str::FromStr;

/// Bytes of a token (the devkit's `HexLen8`).
pub const TOKEN_BYTES: usize = 8;

/// The name of a row of a log; that of a `lidar_pc` row also names the scenario around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Deserialize)]
#[serde(try_from = "String")]
pub struct Token([u8; TOKEN_BYTES]);

impl Token {
    /// From the bytes of a log.
    pub const fn new(bytes: [u8; TOKEN_BYTES]) -> Self {
        Self(bytes)
    }

    /// The bytes that a log stores.
    pub const fn bytes(&self) -> &[u8; TOKEN_BYTES] {
        &self.0
    }
}

/// A text that is no token.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("'{0}' is no token: expected 16 hexadecimal digits in quotes")]
pub struct TokenError(pub String);

impl FromStr for Token {
    type Err = TokenError;

    fn from_str(text: &str) -> Result<Self, TokenError> {
        let wrong = || TokenError(text.to_owned());
        if text.len() != 2 * TOKEN_BYTES || !text.bytes().all(|b| b.is_ascii_hexdigit()) {
            return Err(wrong());
        }
        u64::from_str_radix(text, 16)
            .map(|number| Self(number.to_be_bytes()))
            .map_err(|_| wrong())
    }
}

impl TryFrom<String> for Token {
    type Error = TokenError;

    fn try_from(text: String) -> Result<Self, TokenError> {
        text.parse()
    }
}

impl fmt::Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", u64::from_be_bytes(self.0))
    }
}

impl ToSql for Token {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        Ok(ToSqlOutput::Borrowed(ValueRef::Blob(&self.0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_sixteen_hexadecimal_digits() {
        let token: Token = "0488dbdf03b55f00".parse().unwrap();
        assert_eq!(
            token.bytes(),
            &[0x04, 0x88, 0xdb, 0xdf, 0x03, 0xb5, 0x5f, 0x00]
        );
        assert_eq!(token.to_string(), "0488dbdf03b55f00");
        for wrong in [
            "",
            "0488dbdf03b55f0",
            "0488dbdf03b55f000",
            "0488dbdf03b55f0g",
            "+488dbdf03b55f00",
        ] {
            assert_eq!(wrong.parse::<Token>(), Err(TokenError(wrong.to_owned())));
        }
    }
}
