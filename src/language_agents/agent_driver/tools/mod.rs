//! The tools that the model calls: detections, forecasts, occupancy and map, filled from the tracked
//! objects and the lane map. What a tool gives is text; a wrong call gets what is wrong with it.

mod call;
mod objects;
mod road;

use crate::agent::beginning;
use call::{Argument, Call};
pub(crate) use objects::SeenObject;
use planagent_agent::reasoning::ToolUse;
use planagent_mllm::Constraint;
use planagent_world::SceneView;
use std::fmt::Write;

/// Tools reach this far along either axis, meters.
pub(crate) const REACH: f64 = 50.0;

/// A kind of information with its tools, of which the model calls one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Group {
    Detection,
    Prediction,
    Occupancy,
    Map,
}

impl Group {
    /// All of them, in the order of the questions.
    pub(crate) const ALL: [Self; 4] = [
        Self::Detection,
        Self::Prediction,
        Self::Occupancy,
        Self::Map,
    ];

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Detection => "detection",
            Self::Prediction => "prediction",
            Self::Occupancy => "occupancy",
            Self::Map => "map",
        }
    }

    /// Its tools.
    pub(crate) fn tools(self) -> impl Iterator<Item = &'static Tool> {
        TOOLS.iter().filter(move |tool| tool.group == self)
    }
}

/// A parameter of a tool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Parameter {
    /// Four bounds of an area, meters.
    Area,
    /// A list of numbers of objects.
    ObjectIds,
    /// Which half second, from the first to the last.
    Timestep(i64, i64),
    /// A list of places.
    Locations,
}

impl Parameter {
    /// As a call writes it.
    fn signature(self) -> String {
        match self {
            Self::Area => "x_start, x_end, y_start, y_end".to_owned(),
            Self::ObjectIds => "object_ids=[0, 1]".to_owned(),
            Self::Timestep(first, last) => format!("timestep={first} to {last}"),
            Self::Locations => "locations=[(x,y), (x,y)]".to_owned(),
        }
    }
}

/// A tool.
#[derive(Debug)]
pub(crate) struct Tool {
    group: Group,
    pub(crate) name: &'static str,
    parameters: &'static [Parameter],
    about: &'static str,
    give: fn(&Facts<'_>, &Arguments) -> String,
}

impl Tool {
    /// The tool with its parameters and what it is for, in a line.
    pub(crate) fn line(&self) -> String {
        let parameters: Vec<String> = self
            .parameters
            .iter()
            .map(|parameter| parameter.signature())
            .collect();
        format!("{}({}): {}", self.name, parameters.join(", "), self.about)
    }
}

/// The arguments of a call that is right.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Arguments {
    area: [f64; 4],
    object_ids: Vec<usize>,
    timestep: usize,
    locations: Vec<(f64, f64)>,
}

use Parameter::{Area, Locations, ObjectIds, Timestep};

static TOOLS: [Tool; 18] = [
    Tool {
        group: Group::Detection,
        name: "lead_object",
        parameters: &[],
        about: "the objects in your lane within 10 m ahead",
        give: |facts, _| facts.detections(SeenObject::leads),
    },
    Tool {
        group: Group::Detection,
        name: "objects_around",
        parameters: &[],
        about: "the objects within 20 m on all sides",
        give: |facts, _| facts.detections(|object| object.within([-20.0, 20.0, -20.0, 20.0])),
    },
    Tool {
        group: Group::Detection,
        name: "objects_in_front",
        parameters: &[],
        about: "the objects up to 20 m ahead and 5 m to the sides",
        give: |facts, _| facts.detections(|object| object.within([-5.0, 5.0, 0.0, 20.0])),
    },
    Tool {
        group: Group::Detection,
        name: "objects_in_area",
        parameters: &[Area],
        about: "the objects in an area of your choice",
        give: |facts, call| facts.detections(|object| object.within(call.area)),
    },
    Tool {
        group: Group::Detection,
        name: "all_objects",
        parameters: &[],
        about: "every object; a long list that is rarely needed",
        give: |facts, _| facts.detections(|_| true),
    },
    Tool {
        group: Group::Prediction,
        name: "lead_future",
        parameters: &[],
        about: "where the objects in your lane within 10 m ahead go in 3 s",
        give: |facts, _| facts.futures(SeenObject::leads),
    },
    Tool {
        group: Group::Prediction,
        name: "futures_of",
        parameters: &[ObjectIds],
        about: "where these objects go in 3 s",
        give: |facts, call| facts.futures(|object| call.object_ids.contains(&object.id)),
    },
    Tool {
        group: Group::Prediction,
        name: "futures_in_area",
        parameters: &[Area],
        about: "where the objects that are in an area now go in 3 s",
        give: |facts, call| facts.futures(|object| object.within(call.area)),
    },
    Tool {
        group: Group::Prediction,
        name: "places_at",
        parameters: &[ObjectIds, Timestep(1, 6)],
        about: "where these objects are after a number of half seconds",
        give: |facts, call| facts.places_at(call),
    },
    Tool {
        group: Group::Prediction,
        name: "all_futures",
        parameters: &[],
        about: "where every object goes in 3 s; a long list that is rarely needed",
        give: |facts, _| facts.futures(|_| true),
    },
    Tool {
        group: Group::Occupancy,
        name: "occupied_at",
        parameters: &[Locations, Timestep(0, 4)],
        about: "whether places are occupied after a number of half seconds",
        give: |facts, call| facts.occupied_at(call),
    },
    Tool {
        group: Group::Map,
        name: "drivable_at",
        parameters: &[Locations],
        about: "whether places are drivable",
        give: |facts, call| road::drivable_at(facts.scene, &call.locations),
    },
    Tool {
        group: Group::Map,
        name: "line_at",
        parameters: &[Locations],
        about: "which line is at places: divider, boundary, crosswalk or none",
        give: |facts, call| road::line_at(facts.scene, &call.locations),
    },
    Tool {
        group: Group::Map,
        name: "shoulder_at",
        parameters: &[Locations],
        about: "how far the edges of the road are from places",
        give: |facts, call| road::shoulder_at(facts.scene, &call.locations),
    },
    Tool {
        group: Group::Map,
        name: "shoulder_here",
        parameters: &[],
        about: "how far the edges of the road are from you",
        give: |facts, _| road::shoulder_at(facts.scene, &[(0.0, 0.0)]),
    },
    Tool {
        group: Group::Map,
        name: "divider_at",
        parameters: &[Locations],
        about: "how far the lane dividers are from places",
        give: |facts, call| road::divider_at(facts.scene, &call.locations),
    },
    Tool {
        group: Group::Map,
        name: "divider_here",
        parameters: &[],
        about: "how far the lane dividers are from you",
        give: |facts, _| road::divider_at(facts.scene, &[(0.0, 0.0)]),
    },
    Tool {
        group: Group::Map,
        name: "nearest_crosswalk",
        parameters: &[],
        about: "where the nearest crosswalk ahead is",
        give: |facts, _| road::nearest_crosswalk(facts.scene),
    },
];

/// What the tools are filled from.
pub(crate) struct Facts<'a> {
    scene: &'a SceneView<'a>,
    objects: Vec<SeenObject>,
}

impl<'a> Facts<'a> {
    pub(crate) fn from_scene(scene: &'a SceneView<'a>) -> Self {
        Self {
            scene,
            objects: objects::seen(scene),
        }
    }

    /// The objects, the nearest first.
    pub(crate) fn objects(&self) -> &[SeenObject] {
        &self.objects
    }

    /// The objects with their places, for reasons that name them.
    pub(crate) fn names(&self) -> Vec<String> {
        self.objects
            .iter()
            .map(|object| {
                let (x, y) = object.places[0];
                format!("{} at ({x:.2},{y:.2})", object.kind)
            })
            .collect()
    }

    /// Carries out the call in an answer that belongs to a group.
    pub(crate) fn answer(&self, group: Group, text: &str) -> ToolUse {
        let call = match call::read(text) {
            Ok(call) => call,
            Err(why) => {
                return ToolUse {
                    function: String::new(),
                    arguments: text.trim().to_owned(),
                    result: format!("error: {why}"),
                    failed: true,
                };
            }
        };
        let (function, arguments) = (call.function.clone(), call.text.clone());
        let (result, failed) = match self.give(group, &call) {
            Ok(result) => (result, false),
            Err(why) => (format!("error: {why}"), true),
        };
        ToolUse {
            function,
            arguments,
            result,
            failed,
        }
    }

    fn give(&self, group: Group, call: &Call) -> Result<String, String> {
        let tool = group
            .tools()
            .find(|tool| tool.name == call.function)
            .ok_or_else(|| {
                let known: Vec<&str> = group.tools().map(|tool| tool.name).collect();
                format!(
                    "there is no {} tool '{}'; there are {}",
                    group.name(),
                    beginning(&call.function),
                    known.join(", ")
                )
            })?;
        let arguments = self
            .arguments(tool, call)
            .map_err(|why| format!("{why}; the call is {}", tool.line()))?;
        Ok((tool.give)(self, &arguments))
    }

    fn arguments(&self, tool: &Tool, call: &Call) -> Result<Arguments, String> {
        let mut given = call.arguments.iter().cloned();
        let mut found = Arguments::default();
        for parameter in tool.parameters {
            match parameter {
                Area => {
                    for (bound, name) in found
                        .area
                        .iter_mut()
                        .zip(["x_start", "x_end", "y_start", "y_end"])
                    {
                        *bound = call::number(&call::take(&mut given, name)?, name)?;
                        if bound.abs() > REACH {
                            return Err(format!("{name} must lie in -{REACH} to {REACH}"));
                        }
                    }
                    let [x_start, x_end, y_start, y_end] = found.area;
                    if x_start > x_end || y_start > y_end {
                        return Err("an area starts before it ends".to_owned());
                    }
                }
                ObjectIds => {
                    found.object_ids = self.ids(&call::take(&mut given, "object_ids")?)?;
                }
                Timestep(first, last) => {
                    let step = call::number(&call::take(&mut given, "timestep")?, "timestep")?;
                    if step.fract() != 0.0 || !(*first as f64..=*last as f64).contains(&step) {
                        return Err(format!("timestep must be one of {first} to {last}"));
                    }
                    found.timestep = step as usize;
                }
                Locations => {
                    let places = call::places(&call::take(&mut given, "locations")?)?;
                    if let Some((x, y)) = places
                        .iter()
                        .find(|(x, y)| x.abs() > REACH || y.abs() > REACH)
                    {
                        return Err(format!("({x:.2},{y:.2}) is farther than {REACH} m"));
                    }
                    found.locations = places;
                }
            }
        }
        // An argument too many is an error: the model asked for something that this tool does not
        // do.
        match given.next() {
            Some(Argument { name, .. }) => Err(format!(
                "{} is one argument too many",
                name.map_or_else(|| "the last".to_owned(), |name| beginning(&name))
            )),
            None => Ok(found),
        }
    }

    /// Numbers of objects that there are.
    fn ids(&self, argument: &Argument) -> Result<Vec<usize>, String> {
        let ids = call::numbers(argument)?;
        ids.into_iter()
            .map(|id| {
                let known =
                    (0..self.objects.len()).find(|&known| (known as f64).total_cmp(&id).is_eq());
                known.ok_or_else(|| {
                    let id = beginning(&id.to_string());
                    match self.objects.len() {
                        0 => format!("there is no object {id}, and no other"),
                        count => format!("there is no object {id}; there are 0 to {}", count - 1),
                    }
                })
            })
            .collect()
    }

    fn detections(&self, is_meant: impl Fn(&SeenObject) -> bool) -> String {
        let mut text = String::new();
        for object in self.objects.iter().filter(|object| is_meant(object)) {
            let (x, y) = object.places[0];
            let (width, length) = object.size;
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "object {}: {} at ({x:.2},{y:.2}), width and length ({width:.2},{length:.2})",
                object.id, object.kind
            );
        }
        or_none(&text, "no object is there")
    }

    fn futures(&self, is_meant: impl Fn(&SeenObject) -> bool) -> String {
        let mut text = String::new();
        for object in self.objects.iter().filter(|object| is_meant(object)) {
            let places: Vec<String> = object.places[1..]
                .iter()
                .map(|(x, y)| format!("({x:.2},{y:.2})"))
                .collect();
            let _ = writeln!(
                text,
                "object {}: {} goes through [{}]",
                object.id,
                object.kind,
                places.join(", ")
            );
        }
        or_none(&text, "no object is there")
    }

    fn places_at(&self, call: &Arguments) -> String {
        let mut text = String::new();
        for object in self
            .objects
            .iter()
            .filter(|object| call.object_ids.contains(&object.id))
        {
            let (x, y) = object.places[call.timestep.min(objects::STEPS)];
            let _ = writeln!(
                text,
                "object {}: {} at ({x:.2},{y:.2}) after {:.1} s",
                object.id,
                object.kind,
                call.timestep as f64 * objects::STEP_S
            );
        }
        or_none(&text, "no object is there")
    }

    fn occupied_at(&self, call: &Arguments) -> String {
        let mut text = String::new();
        for &(x, y) in &call.locations {
            let occupied = self
                .objects
                .iter()
                .any(|object| object.covers((x, y), call.timestep));
            let word = if occupied { "occupied" } else { "free" };
            let _ = writeln!(
                text,
                "({x:.2},{y:.2}) is {word} after {:.1} s",
                call.timestep as f64 * objects::STEP_S
            );
        }
        or_none(&text, "no place was asked about")
    }
}

fn or_none(text: &str, none: &str) -> String {
    if text.is_empty() {
        none.to_owned()
    } else {
        text.trim_end().to_owned()
    }
}

/// The grammar of a call of one of a group's tools, with objects that there are.
pub(crate) fn call_grammar(group: Group, facts: &Facts<'_>) -> Constraint {
    call::grammar(group.tools(), facts.objects.len())
}

#[cfg(test)]
mod tests;
