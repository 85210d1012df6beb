//! What is changed in a model's own answers, and which codes then agree with the change. The table
//! was written before any model was asked; docs/cards.md explains it.

use planagent_agent::environment::CenterlineName;
use planagent_agent::reasoning::{Names, PlannerCode, Round, target_speeds};

/// One change of one answer.
#[derive(Debug)]
pub(super) struct Change {
    pub(super) name: &'static str,
    /// The round whose answer is changed; the later ones are generated again.
    pub(super) round: Round,
    /// Where it may stand: of these the first that the answer has is changed.
    pub(super) places: &'static [Place],
    pub(super) expected: Expected,
}

/// A value of an answer behind its key, and what it becomes.
#[derive(Debug)]
pub(super) struct Place {
    key: &'static str,
    /// The values that are changed; another one leaves the state out.
    from: &'static [&'static str],
    to: &'static str,
}

/// The codes that agree with a change, compared with the code that the model gave without it. The
/// code without the change never agrees: a model whose code does not depend on the answer has a
/// share of 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Expected {
    /// A lower v0.
    Slower,
    /// A higher v0.
    Faster,
    /// A lower v0 or another centerline.
    Yields,
    /// The same, or a lead agent where none was named.
    FollowsOrYields,
    /// Any centerline but this one.
    Leaves(CenterlineName),
    /// One of these centerlines.
    Takes(&'static [CenterlineName]),
}

const fn place(key: &'static str, from: &'static [&'static str], to: &'static str) -> Place {
    Place { key, from, to }
}

/// All changes. The keys are those of the forms `choices`, `choices-2`, `short` and `reasoned`
/// (docs/prompts.md); understanding in free sentences has none.
pub(super) const CHANGES: [Change; 11] = [
    Change {
        name: "a lead vehicle is near",
        round: Round::Understanding,
        places: &[
            place("lead_distance=", &["none"], "near"),
            place("Ahead: ", &["nothing"], "vehicle"),
        ],
        expected: Expected::FollowsOrYields,
    },
    Change {
        name: "the lane is blocked nearby",
        round: Round::Understanding,
        places: &[
            place("blocked=", &["none"], "near"),
            place("Ahead: ", &["nothing"], "obstacle"),
        ],
        expected: Expected::Yields,
    },
    Change {
        name: "a person is on the path",
        round: Round::Understanding,
        places: &[
            place("person_on_path=", &["none"], "near"),
            place("pedestrian=", &["none"], "near"),
            place("Ahead: ", &["nothing"], "pedestrian"),
        ],
        expected: Expected::Yields,
    },
    Change {
        name: "the light is red",
        round: Round::Understanding,
        places: &[
            place("light=", &["none", "green"], "red"),
            place("Light: ", &["none", "green"], "red"),
        ],
        expected: Expected::Slower,
    },
    Change {
        name: "the left lane is occupied",
        round: Round::Understanding,
        places: &[
            place("left_lane=", &["free"], "occupied"),
            place("Left lane: ", &["free"], "occupied"),
        ],
        expected: Expected::Leaves(CenterlineName::LeftLane),
    },
    Change {
        name: "the right lane is occupied",
        round: Round::Understanding,
        places: &[
            place("right_lane=", &["free"], "occupied"),
            place("Right lane: ", &["free"], "occupied"),
        ],
        expected: Expected::Leaves(CenterlineName::RightLane),
    },
    Change {
        name: "keep becomes change_left",
        round: Round::Instruction,
        places: &[
            place("lat=", &["keep"], "change_left"),
            place("Lane: ", &["keep"], "change_left"),
            place("Lateral: ", &["keep"], "change_left"),
        ],
        expected: Expected::Takes(&[CenterlineName::LeftLane, CenterlineName::OncomingLane]),
    },
    Change {
        name: "keep becomes change_right",
        round: Round::Instruction,
        places: &[
            place("lat=", &["keep"], "change_right"),
            place("Lane: ", &["keep"], "change_right"),
            place("Lateral: ", &["keep"], "change_right"),
        ],
        expected: Expected::Takes(&[CenterlineName::RightLane]),
    },
    Change {
        name: "a lane change becomes keep",
        round: Round::Instruction,
        places: &[
            place("lat=", &["change_left", "change_right"], "keep"),
            place("Lane: ", &["change_left", "change_right"], "keep"),
            place("Lateral: ", &["change_left", "change_right"], "keep"),
        ],
        expected: Expected::Takes(&[CenterlineName::EgoLane]),
    },
    Change {
        name: "the speed becomes decelerate",
        round: Round::Instruction,
        places: &[
            place("lon=", &["accelerate", "maintain"], "decelerate"),
            place("Speed: ", &["accelerate", "maintain"], "decelerate"),
            place("Longitudinal: ", &["accelerate", "maintain"], "decelerate"),
        ],
        expected: Expected::Slower,
    },
    Change {
        name: "the speed becomes accelerate",
        round: Round::Instruction,
        places: &[
            place("lon=", &["decelerate", "maintain"], "accelerate"),
            place("Speed: ", &["decelerate", "maintain"], "accelerate"),
            place("Longitudinal: ", &["decelerate", "maintain"], "accelerate"),
        ],
        expected: Expected::Faster,
    },
];

impl Change {
    /// The answer with the change; none where it has no such value.
    pub(super) fn of_answer(&self, answer: &str) -> Option<String> {
        let place = |place: &Place| place.replaced(answer);
        self.places.iter().find_map(place)
    }
}

impl Place {
    fn replaced(&self, answer: &str) -> Option<String> {
        let is_start = |at: usize| {
            let before = answer.get(..at).and_then(|before| before.chars().last());
            // A key of a line begins it: a reason in free text may have the same words.
            let begins_line = self.key.ends_with(": ");
            before.is_none_or(|c| c == '\n' || (c.is_whitespace() && !begins_line))
        };
        let ends = |c: char| c.is_whitespace() || c == ',';
        for (at, _) in answer
            .match_indices(self.key)
            .filter(|(at, _)| is_start(*at))
        {
            let (before, rest) = answer.split_at_checked(at + self.key.len())?;
            let value = rest.split_once(ends).map_or(rest, |(value, _)| value);
            if self.from.contains(&value) {
                let behind = rest.strip_prefix(value)?;
                return Some(format!("{before}{}{behind}", self.to));
            }
        }
        None
    }
}

impl Expected {
    /// Whether a code agrees with the change, given the code without it.
    pub(super) fn agrees(self, own: &PlannerCode, new: &PlannerCode) -> bool {
        let is_slower = new.target_speed < own.target_speed;
        let leaves = new.centerline != own.centerline;
        match self {
            Self::Slower => is_slower,
            Self::Faster => new.target_speed > own.target_speed,
            Self::Yields => is_slower || leaves,
            Self::FollowsOrYields => {
                is_slower || leaves || (own.lead_agent.is_none() && new.lead_agent.is_some())
            }
            Self::Leaves(centerline) => new.centerline != centerline,
            Self::Takes(centerlines) => centerlines.contains(&new.centerline),
        }
    }

    /// Whether the code without the change does not agree yet, and another code of the scene does.
    pub(super) fn can_be_met(self, own: &PlannerCode, names: &Names) -> bool {
        let has_other = names.centerlines.iter().any(|name| *name != own.centerline);
        let may_slow = own.target_speed > 0.0;
        match self {
            Self::Slower => may_slow,
            Self::Faster => own.target_speed < f64::from(*target_speeds(names).end()),
            Self::Yields => may_slow || has_other,
            Self::FollowsOrYields => {
                may_slow || has_other || (own.lead_agent.is_none() && !names.lead_agents.is_empty())
            }
            Self::Leaves(centerline) => own.centerline == centerline && has_other,
            Self::Takes(centerlines) => {
                !centerlines.contains(&own.centerline)
                    && names
                        .centerlines
                        .iter()
                        .any(|name| centerlines.contains(name))
            }
        }
    }

    /// The codes that agree, in words.
    pub(super) fn in_words(self) -> String {
        match self {
            Self::Slower => "a lower v0".to_owned(),
            Self::Faster => "a higher v0".to_owned(),
            Self::Yields => "a lower v0 or another centerline".to_owned(),
            Self::FollowsOrYields => "a lower v0, another centerline, or a new la".to_owned(),
            Self::Leaves(centerline) => format!("any centerline but {centerline}"),
            Self::Takes(centerlines) => {
                let names: Vec<&str> = centerlines.iter().map(|name| name.as_str()).collect();
                names.join(" or ")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_agent::environment::facts::Question;
    use planagent_agent::reasoning::{Lateral, Longitudinal, parse};

    fn names() -> Names {
        Names {
            centerlines: vec![
                CenterlineName::EgoLane,
                CenterlineName::LeftLane,
                CenterlineName::RightLane,
            ],
            lead_agents: vec!["vehicle1".parse().unwrap()],
            speed_limit: Some(10),
        }
    }

    /// Codes of every centerline, with and without a lead agent, at three speeds.
    fn codes() -> Vec<PlannerCode> {
        let mut codes = Vec::new();
        for c in ["ego_lane", "left_lane", "right_lane"] {
            for la in ["None", "vehicle1"] {
                for v0 in [0, 5, 10] {
                    let line =
                        format!("Generate_IDM_Planner(c={c}, la={la}, v0={v0}, acc=1.5, dec=3)");
                    codes.push(parse(&line, &names()).answer.unwrap());
                }
            }
        }
        codes
    }

    #[test]
    fn the_code_without_the_change_never_agrees_and_some_code_does() {
        for change in &CHANGES {
            let mut asked = 0;
            for own in codes() {
                if !change.expected.can_be_met(&own, &names()) {
                    continue;
                }
                asked += 1;
                assert!(
                    !change.expected.agrees(&own, &own),
                    "{}: {own}",
                    change.name
                );
                let meets = |new: &PlannerCode| change.expected.agrees(&own, new);
                assert!(codes().iter().any(meets), "{}: {own}", change.name);
            }
            assert!(asked > 0, "{} is asked nowhere", change.name);
        }
    }

    #[test]
    fn agreement_is_by_speed_centerline_and_lead() {
        let of = |c: &str, la: &str, v0: u32| {
            let line = format!("Generate_IDM_Planner(c={c}, la={la}, v0={v0}, acc=1.5, dec=3)");
            parse(&line, &names()).answer.unwrap()
        };
        let own = of("ego_lane", "None", 5);
        let (slower, aside, led) = (
            of("ego_lane", "None", 4),
            of("left_lane", "None", 5),
            of("ego_lane", "vehicle1", 5),
        );
        for (expected, agreeing) in [
            (Expected::Slower, [true, false, false]),
            (Expected::Yields, [true, true, false]),
            (Expected::FollowsOrYields, [true, true, true]),
            (Expected::Faster, [false, false, false]),
            (
                Expected::Takes(&[CenterlineName::LeftLane]),
                [false, true, false],
            ),
        ] {
            let found = [slower, aside, led].map(|new| expected.agrees(&own, &new));
            assert_eq!(found, agreeing, "{expected:?}");
        }
        assert!(!Expected::Slower.can_be_met(&of("ego_lane", "None", 0), &names()));
        assert!(!Expected::Faster.can_be_met(&of("ego_lane", "None", 10), &names()));
        let one_lane = Names {
            centerlines: vec![CenterlineName::EgoLane],
            ..names()
        };
        assert!(!Expected::Takes(&[CenterlineName::LeftLane]).can_be_met(&own, &one_lane));
    }

    #[test]
    fn a_change_replaces_one_value_of_each_form_and_nothing_else() {
        let named = |name: &str| CHANGES.iter().find(|change| change.name == name).unwrap();
        let keep = named("keep becomes change_left");
        for (answer, changed) in [
            (
                "why=lane_serves lat=keep why=free_road lon=accelerate",
                Some("why=lane_serves lat=change_left why=free_road lon=accelerate"),
            ),
            (
                "Speed: maintain\nLane: keep\nReason: keep left",
                Some("Speed: maintain\nLane: change_left\nReason: keep left"),
            ),
            (
                "Longitudinal: maintain, because a\nLateral: keep, because Lane: keep",
                Some("Longitudinal: maintain, because a\nLateral: change_left, because Lane: keep"),
            ),
            ("why=lane_serves lat=change_right", None),
            ("flat=keep", None),
            ("", None),
        ] {
            assert_eq!(keep.of_answer(answer).as_deref(), changed, "{answer}");
        }
        let person = named("a person is on the path");
        assert_eq!(
            person
                .of_answer("pedestrian=none person_on_path=none")
                .unwrap(),
            "pedestrian=none person_on_path=near"
        );
        assert_eq!(
            person.of_answer("Ahead: nothing\n").unwrap(),
            "Ahead: pedestrian\n"
        );
        assert_eq!(person.of_answer("pedestrian=nonesuch"), None);
    }

    #[test]
    fn keys_and_values_are_those_of_the_grammars() {
        let places = || CHANGES.iter().flat_map(|change| change.places);
        for place in places() {
            let values = || place.from.iter().chain([&place.to]);
            let of = |texts: &[&str]| values().all(|value| texts.contains(value));
            let key = place.key.trim_end_matches('=');
            let question = Question::ALL
                .iter()
                .find(|question| question.as_str() == key);
            let known = match (question, place.key) {
                (Some(question), _) => of(question.choices()),
                (None, "lat=" | "Lane: " | "Lateral: ") => of(Lateral::TEXTS),
                (None, "lon=" | "Speed: " | "Longitudinal: ") => of(Longitudinal::TEXTS),
                (None, "Light: ") => of(Question::Light.choices()),
                (None, "Left lane: " | "Right lane: ") => of(Question::LeftLane.choices()),
                (None, "Ahead: ") => of(&["nothing", "vehicle", "pedestrian", "obstacle"]),
                _ => false,
            };
            assert!(known, "{place:?}");
        }
    }
}
