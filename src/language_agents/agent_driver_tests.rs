//! Agent-Driver with a scripted model and with an oracle.

use crate::agent_driver::ExperienceItem;
use crate::memory::Memory;
use crate::tests::{Stub, asked_seldom, default_scene, drive};
use planagent_agent::planner::{Decision, LanguageAgentSettings, PlanAgentSettings};
use planagent_agent::reasoning::PlannerAnswer;
use planagent_agent::simulation::Challenge;

/// Asks for detections and the map, calls one right and one wrong tool, and goes on slowly.
fn agent(prompt: &str, _: usize) -> String {
    if prompt.contains("of the kind") {
        let needed = prompt.contains("detection") || prompt.contains("map");
        return if needed { "YES" } else { "NO" }.to_owned();
    }
    if prompt.contains("Call one of") && prompt.contains("objects_around") {
        return "objects_around()".to_owned();
    }
    if prompt.contains("Call one of") {
        return "drivable_at(locations=[(0,900)])".to_owned();
    }
    if prompt.contains("Which drive") {
        return "2".to_owned();
    }
    if prompt.contains("Rules:") {
        let line = prompt
            .lines()
            .find(|line| line.contains("Speed along the heading"))
            .unwrap();
        let number = line.rsplit('(').next().unwrap().trim_end_matches(')');
        let step: f64 = number.parse::<f64>().unwrap().max(1.0);
        let places = (1..=6).map(|i| format!("(0.00,{:.2})", step * f64::from(i)));
        return format!("Trajectory: [{}]", places.collect::<Vec<_>>().join(", "));
    }
    "Reasons: none\nPlan: move forward at constant speed".to_owned()
}

#[test]
fn agent_driver_drives_the_default_scene_with_tools_in_its_records() {
    for challenge in Challenge::CLOSED_LOOP {
        let (scenario, settings) = (default_scene(), PlanAgentSettings::default());
        let model = Stub::new(agent);
        let (calls, _) = drive(
            "agent-driver",
            Some(model.clone()),
            &scenario,
            challenge,
            &settings,
        );
        let at: Vec<usize> = calls.iter().map(|call| call.iteration).collect();
        assert_eq!(&at[..3], [0, 20, 40], "every two seconds");
        for call in &calls {
            assert_eq!(call.decision, Decision::Execute(0), "{:?}", call.attempts);
            let attempt = &call.attempts[0];
            assert!(matches!(attempt.answer, Some(PlannerAnswer::Waypoints(_))));
            let names: Vec<&str> = attempt.rounds.iter().map(|r| r.round.as_str()).collect();
            let expected = [
                "need",
                "tool",
                "need",
                "need",
                "need",
                "tool",
                "reasoning",
                "waypoints",
            ];
            assert_eq!(names, expected, "no memory, so nothing is recalled");
            let tool = |round: usize| attempt.rounds[round].tool.as_ref().unwrap();
            assert_eq!(
                (tool(1).function.as_str(), tool(1).failed),
                ("objects_around", false)
            );
            assert!(tool(5).failed && tool(5).result.contains("farther than 50 m"));
            assert_eq!(tool(7).function, "collision_check");
        }
        let asked = model.asked.lock().unwrap();
        let plan = asked
            .iter()
            .find(|(prompt, _)| prompt.contains("Rules:"))
            .unwrap();
        assert!(plan.0.contains("error: (0.00,900.00)"), "{}", plan.0);
        assert!(plan.0.contains("Reasons: none"));
    }
}

#[test]
fn the_experience_that_the_model_picks_stands_in_the_plan() {
    let item = |n: usize| ExperienceItem {
        text: format!("Drive number {n}"),
        motion: [0.0; 9],
        goal: "FORWARD".to_owned(),
        past: [[0.0, 0.0]; 4],
        future: [[0.0, n as f64]; 6],
        source: "a test".to_owned(),
    };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("memory.json");
    let memory = Memory::new(
        "agent-driver",
        "a test".to_owned(),
        (1..=4).map(item).collect(),
    );
    std::fs::write(&file, serde_json::to_string(&memory).unwrap()).unwrap();
    let mut language_agents = LanguageAgentSettings::default();
    language_agents.agent_mut("agent-driver").memory = Some(file.to_str().unwrap().to_owned());
    let settings = PlanAgentSettings {
        language_agents,
        ..PlanAgentSettings::default()
    };
    let scenario = default_scene();
    let challenge = Challenge::NonReactive;
    let model = Stub::new(agent);
    drive(
        "agent-driver",
        Some(model.clone()),
        &scenario,
        challenge,
        &settings,
    );
    let asked = model.asked.lock().unwrap();
    let recalled = asked
        .iter()
        .find(|(p, _)| p.contains("Which drive"))
        .unwrap();
    assert!(recalled.0.contains("Drive number 3") && !recalled.0.contains("Drive number 4"));
    let plan = asked.iter().find(|(p, _)| p.contains("Rules:")).unwrap();
    assert!(plan.0.contains("(0.00,2.00), (0.00,2.00)"), "{}", plan.0);
    let wrong = Stub::new(|prompt, n| {
        if prompt.contains("Which drive") {
            "9".to_owned()
        } else {
            agent(prompt, n)
        }
    });
    let (calls, _) = drive("agent-driver", Some(wrong), &scenario, challenge, &settings);
    assert!(
        calls
            .iter()
            .all(|call| call.decision == Decision::Execute(0))
    );
    assert!(
        calls.iter().all(|call| call.parse_errors() == 1),
        "the wrong number is counted"
    );
}

#[test]
fn what_is_wrong_on_the_way_to_a_plan_is_counted_and_shown() {
    let (scenario, settings) = (default_scene(), asked_seldom());
    let challenge = Challenge::NonReactive;
    let careless = Stub::new(|prompt, n| {
        if prompt.contains("of the kind") {
            return if prompt.contains("map") {
                "YES"
            } else {
                "Yes."
            }
            .to_owned();
        }
        if prompt.contains("Call one of") {
            return "shoulder_here() divider_here()".to_owned();
        }
        if prompt.contains("Rules:") {
            return agent(prompt, n);
        }
        String::new()
    });
    let (calls, _) = drive(
        "agent-driver",
        Some(careless),
        &scenario,
        challenge,
        &settings,
    );
    for call in &calls {
        assert_eq!(call.decision, Decision::Execute(0));
        let attempt = &call.attempts[0];
        let said: Vec<&str> = attempt.errors.iter().map(|e| e.message.as_str()).collect();
        assert_eq!(said.len(), 4, "{said:?}");
        assert!(said[0].starts_with("need of detection: 'Yes.' is neither YES nor NO"));
        assert!(said[3].starts_with("reasoning: the answer is empty"));
        let mut tools = attempt
            .rounds
            .iter()
            .filter_map(|round| round.tool.as_ref());
        let call = tools.next().unwrap();
        assert!(call.failed && call.result.contains("call one tool, not several"));
    }
}

#[test]
fn an_oracle_drives_by_checked_waypoints() {
    let (scenario, settings) = (default_scene(), asked_seldom());
    let challenge = Challenge::NonReactive;
    let (calls, _) = drive("oracle-agent-driver", None, &scenario, challenge, &settings);
    assert_eq!(calls.len(), 3);
    assert!(
        calls
            .iter()
            .all(|call| call.decision == Decision::Execute(0))
    );
}
