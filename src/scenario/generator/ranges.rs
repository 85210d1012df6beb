//! From which ranges a scenario is drawn.

/// From which ranges roads and traffic are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Ranges {
    /// Those of the first scenarios.
    First,
    /// Wider ones, chosen beside recordings.
    Wide,
    /// Still wider ones, chosen beside more recordings: scenes differ more from each other, and maps
    /// and boxes are less exact.
    Wider,
}

impl Ranges {
    /// All that have a part of their own in an id.
    pub(super) const NAMED: [Self; 2] = [Self::Wide, Self::Wider];

    /// Second part of the id; the first ranges have none.
    pub(super) const fn name(self) -> Option<&'static str> {
        match self {
            Self::First => None,
            Self::Wide => Some("wide"),
            Self::Wider => Some("wider"),
        }
    }
}
