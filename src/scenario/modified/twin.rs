//! Text twins: two scenes on one base with the same lane-graph text. One closes the ego's lane, the
//! other the lane beside it. The text names the same things at the same distances; only the picture
//! shows which lane is closed.

use super::error::ModifyError;
use super::file::Modification;
use std::fmt;

/// What the text does not tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum TwinKind {
    /// A stopped vehicle in one lane, behind a cone at its edge: the text names the nearest thing
    /// on a node alone.
    Hidden,
    /// A line of cones in each lane: one is a taper that closes its lane, the other follows the
    /// edge.
    Taper,
    /// A person beside each lane: one walks onto it, the other away.
    Person,
    /// A vehicle beside the road at each lane, off the nodes: one drives into its lane, the other
    /// waits.
    CrossTraffic,
}

impl TwinKind {
    /// All kinds, in the order of their pairs.
    pub const ALL: [Self; 4] = [Self::Hidden, Self::Taper, Self::Person, Self::CrossTraffic];

    /// Its name in words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Hidden => "hidden",
            Self::Taper => "taper",
            Self::Person => "person",
            Self::CrossTraffic => "cross",
        }
    }
}

impl fmt::Display for TwinKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The side of the lane beside the ego's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum TwinSide {
    /// To the left.
    Left,
    /// To the right.
    Right,
}

/// The scene of a pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum TwinPart {
    /// The ego's lane is closed.
    OwnClosed,
    /// The lane beside is closed.
    BesideClosed,
}

impl TwinPart {
    /// Both scenes of a pair.
    pub const ALL: [Self; 2] = [Self::OwnClosed, Self::BesideClosed];
}

/// One of two scenes with one text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Twin {
    /// What the text does not tell.
    pub kind: TwinKind,
    /// Side of the other lane.
    pub side: TwinSide,
    /// Which of the two.
    pub part: TwinPart,
}

/// Written as the name of a modification, `twin_taper_left_a`.
impl fmt::Display for Twin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let part = match self.part {
            TwinPart::OwnClosed => "a",
            TwinPart::BesideClosed => "b",
        };
        write!(f, "{}_{part}", self.pair())
    }
}

impl Twin {
    /// The name of the pair, `twin_taper_left`.
    pub fn pair(self) -> String {
        let side = match self.side {
            TwinSide::Left => "left",
            TwinSide::Right => "right",
        };
        format!("twin_{}_{side}", self.kind)
    }

    /// The twin of a name.
    pub fn named(name: &str) -> Option<Self> {
        let of_kind = |kind| [TwinSide::Left, TwinSide::Right].map(|side| (kind, side));
        let all = TwinKind::ALL.into_iter().flat_map(of_kind);
        let mut all =
            all.flat_map(|(kind, side)| TwinPart::ALL.map(|part| Self { kind, side, part }));
        all.find(|twin| twin.to_string() == name)
    }

    /// Its modification. Both parts draw the same numbers.
    pub(super) fn modification(self) -> Result<Modification, ModifyError> {
        let name = self.to_string();
        let parsed = Modification::parse(&name, &name, &self.text())?;
        Ok(Modification {
            drawn_by: self.pair(),
            ..parsed
        })
    }

    /// The modification as a file would say it.
    fn text(self) -> String {
        let beside: i32 = match self.side {
            TwinSide::Left => 1,
            TwinSide::Right => -1,
        };
        let own_is_closed = self.part == TwinPart::OwnClosed;
        // Each lane with the direction of its outer edge; things stand there, so that the two do
        // not meet.
        let lanes = [
            (0, -f64::from(beside), own_is_closed),
            (beside, f64::from(beside), !own_is_closed),
        ];
        let of_lane = |(lane, outer, is_closed)| match self.kind {
            TwinKind::Hidden => hidden(lane, outer, is_closed),
            TwinKind::Taper => taper(lane, outer, is_closed),
            TwinKind::Person => person(lane, outer, is_closed),
            TwinKind::CrossTraffic => cross_traffic(lane, outer, is_closed),
        };
        format!("{START}{}", lanes.map(of_lane).concat())
    }
}

/// Two lanes, and nobody on them.
const START: &str = "\
[[needs]]
own_lanes = [2, 8]
driven_m = 50

[[remove]]
vehicles = true
people = true
bicycles = true
things = true

";

/// The cone at the edge is the nearest thing on the node of its lane, and the text names no other.
fn hidden(lane: i32, outer: f64, is_closed: bool) -> String {
    let edge = outer * EDGE;
    let cone = format!(
        "[[cones]]\nlane = {lane}\nahead_m = [18, 22]\nfrom_left_m = {edge}\nto_left_m = {edge}\ntaper_m = 0\nlength_m = 0\n\n"
    );
    let left = 0.4 * outer;
    let vehicle = format!(
        "[[stopped]]\nlane = {lane}\nahead_m = [27, 31]\nleft_m = {left}\nheading_deg = [-3, 3]\n\n"
    );
    if is_closed { cone + &vehicle } else { cone }
}

/// A cone here, meters from the centerline, is on the lane and leaves the ego's strip free.
const EDGE: f64 = 1.73;

fn taper(lane: i32, outer: f64, is_closed: bool) -> String {
    /// Where a closing taper ends, meters from the centerline: across the ego's strip.
    const ACROSS: f64 = -0.3;
    let (from, to) = (outer * EDGE, outer * if is_closed { ACROSS } else { EDGE });
    format!(
        "[[cones]]\nlane = {lane}\nahead_m = [19, 24]\nfrom_left_m = {from}\nto_left_m = {to}\ntaper_m = 6\nlength_m = 0\n\
        spacing_m = 2\n\n"
    )
}

/// Walkers on the kerb are on the lane's node, and the text does not tell to which side they cross.
fn person(lane: i32, outer: f64, is_closed: bool) -> String {
    /// Places of a walker, meters from the centerline: on the kerb, in the lane, away from the
    /// road.
    const KERB: f64 = 2.7;
    const IN_LANE: f64 = -0.3;
    const AWAY: f64 = 7.0;
    let (from, to) = (outer * KERB, outer * if is_closed { IN_LANE } else { AWAY });
    format!(
        "[[jaywalker]]\nlane = {lane}\nahead_m = [22, 30]\nfrom_left_m = {from}\nto_left_m = {to}\ntrigger_m = 300\n\
        speed = [1.1, 1.7]\n\n"
    )
}

/// The vehicle stops across its lane and leaves the other one free.
fn cross_traffic(lane: i32, outer: f64, is_closed: bool) -> String {
    /// Places of the crossing vehicle, meters from the centerline: beside the road, in the lane.
    const BESIDE_ROAD: f64 = 8.5;
    const IN_LANE: f64 = 0.8;
    let (from, to) = (outer * BESIDE_ROAD, outer * IN_LANE);
    format!(
        "[[crossing]]\nlane = {lane}\nahead_m = [21, 29]\nfrom_left_m = {from}\nto_left_m = {to}\nspeed = [3.5, 6]\n\
        waits = {}\n\n",
        !is_closed
    )
}
