//! Reads planner code from a model's answer. Reading never fails: it gives the code or a list of
//! errors with their place. The errors go into the feedback prompt and are counted.

use super::call_parser::{Call, ParseError, Signature};
use super::code::{
    ACCEL_MAX, DECEL_MAX, FUNCTION, NO_LEAD_AGENT, Names, PlannerCode, TARGET_SPEED,
};

/// What was read in an answer: the whole line, or the errors in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Parsed<A> {
    /// The line, when all of its arguments were read.
    pub answer: Option<A>,
    /// The errors, in order of place.
    pub errors: Vec<ParseError>,
}

impl<A> Parsed<A> {
    /// Nothing read, and nothing wrong.
    pub const NOTHING: Self = Self {
        answer: None,
        errors: Vec::new(),
    };

    /// An answer without errors.
    pub fn from_answer(answer: A) -> Self {
        Self {
            answer: Some(answer),
            errors: Vec::new(),
        }
    }
}

/// The call of planner code.
const SIGNATURE: Signature<'_> = Signature {
    function: FUNCTION,
    parameters: &["c", "la", "v0", "acc", "dec"],
};

/// Reads the last call of the function in `text`; names are checked against those of the scene.
pub fn parse(text: &str, names: &Names) -> Parsed<PlannerCode> {
    let mut call = match Call::find(text, SIGNATURE) {
        Ok(call) => call,
        Err(error) => {
            return Parsed {
                answer: None,
                errors: vec![error],
            };
        }
    };
    let answer = read(&mut call, names);
    Parsed {
        answer,
        errors: call.into_errors(),
    }
}

fn read(call: &mut Call<'_>, names: &Names) -> Option<PlannerCode> {
    let centerline = call.name("c", &names.centerlines, None);
    let follows = !call.is("la", NO_LEAD_AGENT);
    let lead_agent = if follows {
        call.name("la", &names.lead_agents, Some(NO_LEAD_AGENT))
    } else {
        None
    };
    let target_speed = call.number("v0", TARGET_SPEED);
    let accel_max = call.number("acc", ACCEL_MAX);
    let decel_max = call.magnitude("dec", DECEL_MAX);
    Some(PlannerCode {
        centerline: centerline?,
        lead_agent: if follows { Some(lead_agent?) } else { None },
        target_speed: target_speed?,
        accel_max: accel_max?,
        decel_max: decel_max?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::environment::CenterlineName;
    use proptest::prelude::*;

    fn names() -> Names {
        Names {
            centerlines: vec![CenterlineName::EgoLane, CenterlineName::LeftLane],
            lead_agents: ["vehicle1", "pedestrian2"]
                .map(|name| name.parse().unwrap())
                .to_vec(),
            speed_limit: None,
        }
    }

    fn messages(text: &str) -> Vec<String> {
        parse(text, &names())
            .errors
            .into_iter()
            .map(|error| error.message)
            .collect()
    }

    #[test]
    fn reads_positional_named_and_quoted_arguments() {
        let expected = PlannerCode {
            centerline: CenterlineName::LeftLane,
            lead_agent: Some("vehicle1".parse().unwrap()),
            target_speed: 8.0,
            accel_max: 1.5,
            decel_max: 3.0,
        };
        for text in [
            "Generate_IDM_Planner(left_lane, vehicle1, 8, 1.5, 3)",
            "planner = Generate_IDM_Planner(c=left_lane, la='vehicle1', v0=8.0, acc=1.5, dec=-3.0)  # slow",
            "First Generate_IDM_Planner(ego_lane, None, 1, 1, 1)\nno: generate_idm_planner(dec=3, acc=1.5, v0=8, la=vehicle1, c=left_lane).",
        ] {
            let parsed = parse(text, &names());
            assert_eq!(
                parsed.answer.as_ref(),
                Some(&expected),
                "{text}: {:?}",
                parsed.errors
            );
            assert!(parsed.errors.is_empty(), "{:?}", parsed.errors);
        }
    }

    #[test]
    fn says_what_is_wrong_and_where() {
        assert_eq!(messages("drive on"), ["no call of Generate_IDM_Planner"]);
        assert_eq!(
            messages("Generate_IDM_Planner(up_lane, vehicle1, 8, 1, 3)"),
            ["c names 'up_lane', which is not in the scene"]
        );
        assert_eq!(
            messages("Generate_IDM_Planner(ego_lane, None, 800, 1, 3)"),
            ["v0 = 800 is out of range"]
        );
        assert_eq!(
            messages("Generate_IDM_Planner(ego_lane, None, 8, 1"),
            ["the call is not closed", "dec is missing"]
        );
        assert_eq!(
            messages("Generate_IDM_Planner(ego_lane, None, v0=8, v0=9, acc=1, dec=2)"),
            ["v0 is given twice"]
        );
        let error = &parse("x Generate_IDM_Planner(ego_lane, 7, 8, 1, 3)", &names()).errors[0];
        assert_eq!(
            (error.span.clone(), error.message.as_str()),
            (33..34, "la is not a name")
        );
    }

    proptest! {
        #[test]
        fn any_text_is_read_without_failing(text in "\\PC*") {
            let parsed = parse(&text, &names());
            prop_assert!(parsed.answer.is_some() || !parsed.errors.is_empty());
        }

        #[test]
        fn almost_code_is_read_without_failing(text in "Generate_IDM_Planner[(),=a-z0-9. \"'-]{0,40}") {
            let parsed = parse(&text, &names());
            prop_assert!(parsed.answer.is_some() || !parsed.errors.is_empty());
            for error in &parsed.errors {
                prop_assert!(error.span.end <= text.len() && error.span.start <= error.span.end);
            }
        }

        #[test]
        fn printing_and_reading_are_inverse(
            c in 0usize..2, la in 0usize..3,
            target_speed in 0.0..40.0f64, accel_max in 0.1..5.0f64, decel_max in 0.1..9.0f64,
        ) {
            let names = names();
            let code = PlannerCode {
                centerline: names.centerlines[c],
                lead_agent: names.lead_agents.get(la).copied(),
                target_speed, accel_max, decel_max,
            };
            let parsed = parse(&code.to_string(), &names);
            prop_assert_eq!(parsed.errors, vec![]);
            prop_assert_eq!(parsed.answer, Some(code));
        }
    }
}
