//! Reads the compact text.

use super::environment::lane_graph::{AgentName, Heading, NodePlace};
use super::environment::text::{
    AgentDescription, Description, GoalDescription, LightDescription, NodeDescription,
    OncomingDescription,
};
use super::lexer::{Failed, Reader, TextError};
use super::paper::status;

/// Stands where there is nothing to say.
const NOTHING: &str = "-";

/// With `estimates`, the second version.
pub(super) fn parse(text: &str, estimates: bool) -> Result<Description, Vec<TextError>> {
    let mut reader = Reader::new(text);
    let description = read(&mut reader, estimates).ok();
    reader.finish(description)
}

fn read(reader: &mut Reader<'_>, estimates: bool) -> Result<Description, Failed> {
    reader.expect(&["speed"])?;
    let speed = reader.number("the ego's speed")?;
    reader.expect(&["limit"])?;
    let (mut limit, mut limit_estimate) = (None, None);
    if estimates && reader.accept("~") {
        limit_estimate = Some(reader.number("the estimated limit")?);
    } else if !reader.accept(NOTHING) {
        limit = Some(reader.number("the speed limit")?);
    }
    reader.expect(&["light"])?;
    let light = if reader.accept("none") {
        reader.expect(&[NOTHING])?;
        None
    } else {
        let status = status(reader)?;
        Some(LightDescription {
            status,
            distance: reader.number("the distance to the light")?,
        })
    };
    reader.expect(&["turn"])?;
    let turn = reader.take("the turn of the route")?;
    let mut nodes: [Option<NodeDescription>; 9] = std::array::from_fn(|_| None);
    for &place in NodePlace::ALL {
        reader.expect(&[place.as_str()])?;
        nodes[place as usize] = read_node(reader)?;
        if place == NodePlace::Ego && nodes[place as usize].is_none() {
            return reader.fail("the node under the ego cannot be missing");
        }
    }
    reader.expect(&["rest"])?;
    let rest = reader.number("the number of other agents")?;
    let oncoming = if estimates && reader.accept("oncoming") {
        Some(read_oncoming(reader)?)
    } else {
        None
    };
    let goal = if estimates && reader.accept("goal") {
        Some(read_goal(reader)?)
    } else {
        None
    };
    Ok(Description {
        speed,
        limit,
        limit_estimate,
        lights: [light, None, None],
        turn,
        nodes,
        rest,
        oncoming,
        goal,
    })
}

fn read_goal(reader: &mut Reader<'_>) -> Result<GoalDescription, Failed> {
    let side: NodePlace = reader.take("the side of the goal")?;
    let changes = reader.number("the lane changes to the goal")? as i8;
    let changes = match side {
        NodePlace::Left if changes > 0 => changes,
        NodePlace::Right if changes > 0 => -changes,
        NodePlace::Ego if changes == 0 => 0,
        _ => return reader.fail("the side of the goal contradicts its lane changes"),
    };
    Ok(GoalDescription {
        changes,
        distance: reader.number("the distance to the goal")?.into(),
    })
}

fn read_oncoming(reader: &mut Reader<'_>) -> Result<OncomingDescription, Failed> {
    let blocked = (
        reader.number("the start of what blocks the lane")?,
        reader.number("its end")?,
    );
    if reader.accept(NOTHING) {
        reader.expect(&[NOTHING])?;
        return Ok(OncomingDescription {
            blocked,
            next: None,
        });
    }
    Ok(OncomingDescription {
        blocked,
        next: Some((reader.number("a distance")?, reader.number("a speed")?)),
    })
}

fn read_node(reader: &mut Reader<'_>) -> Result<Option<NodeDescription>, Failed> {
    if reader.accept("none") {
        reader.expect(&[NOTHING, NOTHING])?;
        return Ok(None);
    }
    if reader.accept("free") {
        reader.expect(&[NOTHING, NOTHING])?;
        return Ok(Some(NodeDescription::default()));
    }
    let name: AgentName = reader.take("`free`, `none` or an agent's name")?;
    let distance = reader.number("its distance")?;
    let (speed, heading) = if reader.accept("crossing") {
        (0, Heading::Crossing)
    } else if reader.accept("oncoming") {
        (0, Heading::Oncoming)
    } else {
        (
            reader.number("its speed, `crossing` or `oncoming`")?,
            Heading::Along,
        )
    };
    Ok(Some(NodeDescription {
        apart: false,
        agents: vec![AgentDescription {
            name,
            distance,
            speed,
            heading,
        }],
    }))
}
