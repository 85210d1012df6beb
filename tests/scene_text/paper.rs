//! Reads the readable text.

use super::environment::lane_graph::{AgentName, CenterlineName, Heading, NodePlace};
use super::environment::text::{
    AgentDescription, Description, GoalDescription, LightDescription, NodeDescription,
    OncomingDescription,
};
use super::lexer::{Failed, Reader, TextError};
use super::world::SignalStatus;

/// A node's description, one per place; `None` where there is no node.
type Nodes = [Option<NodeDescription>; 9];

pub(super) fn parse(text: &str) -> Result<Description, Vec<TextError>> {
    let mut reader = Reader::new(text);
    let mut nodes = Nodes::default();
    let mut beside = [None; 3];
    let ego = ego_line(&mut reader);
    let mut whole = ego.is_ok();
    let mut oncoming = None;
    for (line, &centerline) in (2..).zip(CenterlineName::ALL) {
        if !whole {
            reader.seek_line(line);
        }
        if centerline == CenterlineName::OncomingLane {
            if reader.accept(centerline.as_str()) {
                let read = oncoming_line(&mut reader);
                whole &= read.is_ok();
                oncoming = read.ok();
            }
            continue;
        }
        whole &= lane_line(
            &mut reader,
            centerline,
            &mut beside[centerline as usize],
            &mut nodes,
        )
        .is_ok();
    }
    let [_, left, right] = beside;
    let description = ego.ok().map(|ego| Description {
        nodes,
        lights: [ego.lights[0], left, right],
        oncoming,
        ..ego
    });
    reader.finish(description.filter(|_| whole))
}

/// Everything but the nodes and the lights of the lanes beside.
fn ego_line(reader: &mut Reader<'_>) -> Result<Description, Failed> {
    reader.expect(&["Ego", ":"])?;
    let speed = reader.number("the ego's speed")?;
    reader.expect(&["m/s", ",", "limit"])?;
    let (mut limit, mut limit_estimate) = (None, None);
    if reader.accept("unknown") {
        reader.expect(&[","])?;
        if reader.accept("about") {
            limit_estimate = Some(reader.number("the estimated limit")?);
            reader.expect(&["m/s", ","])?;
        }
    } else {
        limit = Some(reader.number("the speed limit")?);
        reader.expect(&["m/s", ","])?;
    }
    reader.expect(&["route"])?;
    let turn = reader.take("the turn of the route")?;
    reader.expect(&[",", "light"])?;
    let own = if reader.accept("none") {
        None
    } else {
        Some(light(reader)?)
    };
    let rest = if reader.accept(",") {
        let rest = reader.number("the number of other agents")?;
        reader.expect(&["more"])?;
        rest
    } else {
        0
    };
    reader.expect(&["."])?;
    let goal = if reader.accept("Goal") {
        Some(read_goal(reader)?)
    } else {
        None
    };
    let (nodes, lights) = (Nodes::default(), [own, None, None]);
    Ok(Description {
        speed,
        limit,
        limit_estimate,
        lights,
        turn,
        nodes,
        rest,
        oncoming: None,
        goal,
    })
}

/// The way to the goal's lane, behind its name.
fn read_goal(reader: &mut Reader<'_>) -> Result<GoalDescription, Failed> {
    reader.expect(&[":"])?;
    let changes = if reader.accept("this") {
        reader.expect(&["lane"])?;
        0
    } else {
        let changes: i8 = reader.take("the lane changes to the goal")?;
        reader.expect(&[if changes == 1 { "lane" } else { "lanes" }, "to", "the"])?;
        if reader.accept("left") {
            changes
        } else {
            reader.expect(&["right"])?;
            -changes
        }
    };
    reader.expect(&[",", "in"])?;
    let distance = reader.take("the distance to the goal")?;
    reader.expect(&["m", "."])?;
    Ok(GoalDescription { changes, distance })
}

/// The way over the oncoming lane, behind its name.
fn oncoming_line(reader: &mut Reader<'_>) -> Result<OncomingDescription, Failed> {
    reader.expect(&[":", "past"])?;
    let from = reader.number("the start of what blocks the lane")?;
    reader.expect(&["m", "to"])?;
    let to = reader.number("its end")?;
    reader.expect(&["m", ";"])?;
    let next = if reader.accept("free") {
        None
    } else {
        reader.expect(&["next", "vehicle"])?;
        let gap = reader.number("its distance")?;
        reader.expect(&["m"])?;
        let speed = reader.number("its speed")?;
        reader.expect(&["m/s"])?;
        Some((gap, speed))
    };
    reader.expect(&["."])?;
    Ok(OncomingDescription {
        blocked: (from, to),
        next,
    })
}

fn light(reader: &mut Reader<'_>) -> Result<LightDescription, Failed> {
    let status = status(reader)?;
    reader.expect(&["in"])?;
    let distance = reader.number("the distance to the light")?;
    reader.expect(&["m"])?;
    Ok(LightDescription { status, distance })
}

/// Takes what a light shows.
pub(super) fn status(reader: &mut Reader<'_>) -> Result<SignalStatus, Failed> {
    let all = [
        SignalStatus::Green,
        SignalStatus::Yellow,
        SignalStatus::Red,
        SignalStatus::Unknown,
    ];
    match all
        .into_iter()
        .find(|status| reader.accept(&status.to_string()))
    {
        Some(status) => Ok(status),
        None => reader.fail("expected what the light shows: green, yellow, red, unknown or none"),
    }
}

fn lane_line(
    reader: &mut Reader<'_>,
    centerline: CenterlineName,
    beside: &mut Option<LightDescription>,
    nodes: &mut Nodes,
) -> Result<(), Failed> {
    reader.expect(&[centerline.as_str(), ":"])?;
    if reader.accept("none") {
        if centerline == CenterlineName::EgoLane {
            return reader.fail("the ego's own lane cannot be missing");
        }
        return reader.expect(&["."]);
    }
    if centerline != CenterlineName::EgoLane && reader.accept("light") {
        *beside = Some(light(reader)?);
        reader.expect(&[";"])?;
    }
    for (i, place) in NodePlace::on(centerline).into_iter().flatten().enumerate() {
        if i > 0 {
            reader.expect(&[";"])?;
        }
        reader.expect(&[place.as_str()])?;
        nodes[place as usize] = read_node(reader)?;
        if place == NodePlace::Ego && nodes[place as usize].is_none() {
            return reader.fail("the node under the ego cannot be missing");
        }
    }
    reader.expect(&["."])
}

fn read_node(reader: &mut Reader<'_>) -> Result<Option<NodeDescription>, Failed> {
    if reader.accept("none") {
        return Ok(None);
    }
    let apart = reader.accept("(");
    if apart {
        reader.expect(&["apart", ")"])?;
    }
    if reader.accept("free") {
        return Ok(Some(NodeDescription {
            apart,
            agents: vec![],
        }));
    }
    let mut agents = vec![read_agent(reader)?];
    while reader.accept(",") {
        agents.push(read_agent(reader)?);
    }
    Ok(Some(NodeDescription { apart, agents }))
}

fn read_agent(reader: &mut Reader<'_>) -> Result<AgentDescription, Failed> {
    let name: AgentName = reader.take("`free`, `none` or an agent's name")?;
    let distance = reader.number("its distance")?;
    reader.expect(&["m"])?;
    let speed = reader.number("its speed")?;
    reader.expect(&["m/s"])?;
    let heading = if reader.accept("crossing") {
        Heading::Crossing
    } else if reader.accept("oncoming") {
        Heading::Oncoming
    } else {
        Heading::Along
    };
    Ok(AgentDescription {
        name,
        distance,
        speed,
        heading,
    })
}
