//! How many codes an attempt proposes.

use serde::{Deserialize, Serialize};

/// How many codes an attempt proposes, 1 to 4.
/// Why: docs/decisions/112-refused-codes.md.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "usize", into = "usize")]
pub struct Proposals(usize);

impl Proposals {
    /// Maximum number.
    const MAX: usize = 4;

    /// The number.
    pub fn get(self) -> usize {
        self.0
    }

    #[allow(
        clippy::trivially_copy_pass_by_ref,
        reason = "serde passes a reference"
    )]
    pub(super) fn is_one(&self) -> bool {
        self.0 == 1
    }
}

impl Default for Proposals {
    fn default() -> Self {
        Self(1)
    }
}

impl From<Proposals> for usize {
    fn from(proposals: Proposals) -> Self {
        proposals.0
    }
}

impl TryFrom<usize> for Proposals {
    type Error = String;

    fn try_from(count: usize) -> Result<Self, String> {
        match count {
            1..=Self::MAX => Ok(Self(count)),
            _ => Err(format!(
                "{count} proposals; an attempt has 1 to {}",
                Self::MAX
            )),
        }
    }
}
