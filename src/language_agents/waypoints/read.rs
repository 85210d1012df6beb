//! Reads a list of waypoints from an answer, and refuses one that no vehicle can follow.

use super::SPACING_S;
use crate::agent::{Reply, beginning};
use crate::chat::Chat;
use planagent_agent::planner::Unreadable;
use planagent_agent::reasoning::{LISTED_WAYPOINTS, ParseError, SeenPlace, WaypointList};
use planagent_world::EgoState;
use planagent_world::geometry::Vector;
use std::ops::Range;

/// From one half second to the next, the motion changes by at most this, m/s: 15 m/s², more than
/// tires give on a road.
const MAX_CHANGE: f64 = 7.5;
/// The word before the list. Of several the last one counts that a list stands right behind.
const LABEL: &str = "trajectory";
/// Places farther than this are no plan of three seconds, meters.
const FARTHEST: f64 = 1_000.0;

/// The ego's motion at the time of a call, m/s: to the right, ahead.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Motion {
    right: f64,
    ahead: f64,
}

impl Motion {
    pub(crate) fn from_ego(ego: &EgoState) -> Self {
        let velocity = ego.center_velocity();
        Self {
            right: -velocity.y,
            ahead: velocity.x,
        }
    }

    pub(crate) fn speed(self) -> f64 {
        Vector::new(self.right, self.ahead).norm()
    }
}

/// Reads the list behind the last label, else the first list, and checks it against the ego's
/// motion. Words behind the list are left alone; a second list there is an error.
pub(crate) fn read_waypoints(answer: &str, motion: Motion, chat: &Chat<'_>) -> Reply<WaypointList> {
    match read(answer) {
        Ok(waypoints) => match jump(&waypoints, motion) {
            None => Reply::plan(waypoints),
            Some(message) => Reply {
                // Kept although it is refused, so that the record and the page show what the model
                // wanted.
                answer: Some(waypoints),
                errors: vec![ParseError {
                    span: list_in(answer),
                    message,
                    hint: format!(
                        "from one half second to the next the speed may change by at most {MAX_CHANGE} m/s"
                    ),
                }],
                unreadable: Some(Unreadable::Jump),
            },
        },
        Err(Fault::NoList) => Reply::wrong(
            ParseError {
                span: answer.len()..answer.len(),
                message: "no list of waypoints".to_owned(),
                hint: hint(),
            },
            chat.without_line(),
        ),
        Err(Fault::In(span, message)) => Reply::wrong(
            ParseError {
                span,
                message,
                hint: hint(),
            },
            chat.with_wrong_line(),
        ),
    }
}

fn hint() -> String {
    format!("write [(x1,y1), ..., (x{LISTED_WAYPOINTS},y{LISTED_WAYPOINTS})] in meters")
}

/// What keeps a list from being read.
#[derive(Debug, PartialEq)]
enum Fault {
    NoList,
    In(Range<usize>, String),
}

/// From the bracket of the list to the end of the answer. A label right before a list goes before
/// one that is only a word of a sentence.
fn list_in(answer: &str) -> Range<usize> {
    let lower = answer.to_ascii_lowercase();
    let (mut lists, mut at) = (Vec::new(), 0);
    for (labels, piece) in lower.split(LABEL).enumerate() {
        if let (1.., Some((between, _))) = (labels, piece.split_once('[')) {
            let is_right_behind = !between.contains(char::is_alphanumeric);
            lists.push((at + between.len(), is_right_behind));
        }
        at += piece.len() + LABEL.len();
    }
    let right_behind = lists
        .iter()
        .rev()
        .find(|(_, is_right_behind)| *is_right_behind);
    let open = right_behind
        .or(lists.last())
        .map_or_else(|| lower.find('['), |(at, _)| Some(*at));
    open.map_or(answer.len()..answer.len(), |at| at..answer.len())
}

fn read(answer: &str) -> Result<WaypointList, Fault> {
    let list = list_in(answer);
    let inside = answer
        .get(list.start + 1..)
        .filter(|_| !list.is_empty())
        .ok_or(Fault::NoList)?;
    // Read by hand, so that an error names its waypoint and its place in the answer.
    let (mut places, mut rest) = (Vec::new(), inside);
    let at = |rest: &str| answer.len() - rest.len();
    loop {
        rest = rest.trim_start_matches(|c: char| c == ',' || c.is_whitespace());
        match rest.chars().next() {
            Some(']') => break,
            Some('(' | '[') => {
                let start = at(rest);
                let (inside, after) = rest[1..].split_once([')', ']']).ok_or_else(|| {
                    Fault::In(start..answer.len(), "the list is not closed".to_owned())
                })?;
                places.push(place(inside).map_err(|why| {
                    let message = format!("waypoint {}: {why}", places.len() + 1);
                    Fault::In(start..at(after), message)
                })?);
                rest = after;
            }
            Some(_) => {
                let message = format!("waypoint {} is no pair of numbers", places.len() + 1);
                return Err(Fault::In(at(rest)..answer.len(), message));
            }
            None => {
                let message = "the list is not closed".to_owned();
                return Err(Fault::In(answer.len()..answer.len(), message));
            }
        }
    }
    // Two lists are two plans, and nothing tells which one is meant.
    let behind = rest
        .strip_prefix(']')
        .expect("the loop above ends at the bracket");
    let second = behind.match_indices('[').find(|(place, _)| {
        let inside = behind[place + 1..].trim_start();
        inside.starts_with(['(', '['])
    });
    if let Some((place, _)) = second {
        let message = "a second list of waypoints stands behind the first".to_owned();
        return Err(Fault::In(at(rest) + 1 + place..answer.len(), message));
    }
    let found = places.len();
    let whole: [SeenPlace; LISTED_WAYPOINTS] = places.try_into().map_err(|_| {
        let message = format!("the list has {found} waypoints instead of {LISTED_WAYPOINTS}");
        Fault::In(list.start..at(rest) + 1, message)
    })?;
    Ok(WaypointList(whole))
}

/// A pair of numbers without its brackets.
fn place(text: &str) -> Result<SeenPlace, String> {
    let number = |text: &str| {
        let text = text.trim();
        match text.parse::<f64>() {
            Ok(value) if value.abs() <= FARTHEST => Ok(value),
            Ok(value) if value.is_finite() => {
                Err(format!("{} is farther than {FARTHEST} m", beginning(text)))
            }
            Ok(_) => Err(format!("{} is not finite", beginning(text))),
            Err(_) => Err(format!("'{}' is no number", beginning(text))),
        }
    };
    let (right, ahead) = text
        .split_once(',')
        .ok_or_else(|| format!("'{}' is no pair", beginning(text)))?;
    Ok(SeenPlace {
        right: number(right)?,
        ahead: number(ahead)?,
    })
}

/// What a list asks for that no vehicle can do.
fn jump(waypoints: &WaypointList, motion: Motion) -> Option<String> {
    let mut before = Vector::zeros();
    let mut velocity = Vector::new(motion.right, motion.ahead);
    for (i, place) in waypoints.0.iter().enumerate() {
        let place = Vector::new(place.right, place.ahead);
        let next = (place - before) / SPACING_S;
        if (next - velocity).norm() > MAX_CHANGE {
            return Some(format!(
                "waypoint {} jumps: {:.1} m/s after {:.1} m/s",
                i + 1,
                next.norm(),
                velocity.norm()
            ));
        }
        (before, velocity) = (place, next);
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEADY: &str =
        "[(0.00,4.00), (0.00,8.00), (0.00,12.00), (0.00,16.00), (0.00,20.00), (0.00,24.00)]";
    const MOTION: Motion = Motion {
        right: 0.0,
        ahead: 8.0,
    };

    #[test]
    fn a_list_is_read_behind_its_label_and_before_what_follows() {
        let text = |before: &str, after: &str| format!("{before}{STEADY}{after}");
        for answer in [
            text("", ""),
            text("Trajectory: ", ""),
            text(
                "I saw [1] a car.\nTrajectory:\n",
                "\nI hope that helps [sic].",
            ),
            STEADY.replace('(', "[").replace(')', "]"),
            STEADY.replace(", ", "\r\n"),
            text("Trajectory: ", "\nThis trajectory keeps to the lane [sic]."),
            text("Trajectory: ", "\nThe trajectory is safe."),
            text(
                "Trajectory: [(0,1), (0,2)]\nNo, better is\nTrajectory: ",
                "",
            ),
            text("The trajectory in meters is ", ""),
        ] {
            let list = read(&answer).unwrap();
            assert_eq!(list.to_string(), STEADY, "{answer}");
            assert_eq!(jump(&list, MOTION), None);
        }
    }

    #[test]
    fn lists_that_are_short_long_open_or_not_finite_are_refused_with_their_reason() {
        let five = STEADY.replace(", (0.00,24.00)", "");
        let seven = STEADY.replace(']', ", (0.00,28.00)]");
        for (answer, why) in [
            ("keep going".to_owned(), "no list"),
            (five, "has 5 waypoints instead of 6"),
            (seven, "has 7 waypoints instead of 6"),
            ("[]".to_owned(), "has 0 waypoints"),
            (
                STEADY.replace("16.00", "nan"),
                "waypoint 4: nan is not finite",
            ),
            (
                STEADY.replace("16.00", "1e999"),
                "waypoint 4: 1e999 is not finite",
            ),
            (
                STEADY.replace("16.00", "far"),
                "waypoint 4: 'far' is no number",
            ),
            (
                STEADY.replace("0.00,16.00", "16.00"),
                "waypoint 4: '16.00' is no pair",
            ),
            (STEADY.replace(']', ""), "not closed"),
            (STEADY.replace(")]", ""), "not closed"),
            ("[here, there]".to_owned(), "waypoint 1 is no pair"),
            (
                STEADY.replace("16.00", "1e300"),
                "waypoint 4: 1e300 is farther than 1000 m",
            ),
            (STEADY.replace("16.00", "\u{ff11}6.00"), "is no number"),
            (STEADY.replace("16.00", "\u{2212}16.00"), "is no number"),
            (
                STEADY.replace("16.00", "16.00,0.00"),
                "'16.00,0.00' is no number",
            ),
            (
                STEADY.replace("[(", "[[("),
                "waypoint 1: '(0.00' is no number",
            ),
            (
                STEADY.replace("[(", "[(("),
                "waypoint 1: '(0.00' is no number",
            ),
            (
                STEADY.replace("16.00", &"9".repeat(100_000)),
                "waypoint 4: 9999999999999999999999999999999999999999 is not finite",
            ),
            (format!("{STEADY} or {STEADY}"), "a second list"),
            (format!("Trajectory: {STEADY}{STEADY}"), "a second list"),
            (format!("{STEADY}\n[["), "a second list"),
        ] {
            let message = match read(&answer).unwrap_err() {
                Fault::NoList => "no list".to_owned(),
                Fault::In(span, message) => {
                    assert!(
                        span.start <= span.end && span.end <= answer.len(),
                        "{answer}"
                    );
                    assert!(message.len() < 200, "{message}");
                    message
                }
            };
            assert!(message.contains(why), "{answer}: {message}");
        }
    }

    #[test]
    fn what_no_vehicle_can_do_is_a_jump() {
        let jumps = |text: &str, ahead: f64| {
            let motion = Motion { right: 0.0, ahead };
            jump(&read(text).unwrap(), motion).is_some()
        };
        let crawl = "[(0,4.0), (0,4.2), (0,4.4), (0,4.6), (0,4.8), (0,5.0)]";
        assert!(jumps(crawl, 0.0), "from standstill");
        let doubled = "[(0,8), (0,16), (0,24), (0,32), (0,40), (0,48)]";
        assert!(jumps(doubled, 8.0), "meters per second for half seconds");
        let swapped = "[(4,0), (8,0), (12,0), (16,0), (20,0), (24,0)]";
        assert!(jumps(swapped, 8.0), "x and y exchanged");
        let back = "[(0,-4), (0,-8), (0,-12), (0,-16), (0,-20), (0,-24)]";
        assert!(jumps(back, 8.0), "the past");
        let stop = "[(0,3.5), (0,6), (0,7.5), (0,8), (0,8), (0,8)]";
        assert!(!jumps(stop, 8.0), "hard braking");
    }
}
