//! The frames of a simulation.

use super::caption::{self, Caption};
use super::error::RenderError;
use super::find::{SimulationChoice, words};
use crate::environment::bev::{BevElement, BevLine, BevView, Palette, Rgb, render_with_lines};
use crate::geometry::Point;
use crate::report::call_record::{CallRecord, LineRecord, calls_in};
use crate::report::number::fixed;
use crate::report::replay::{Moment, Replay, ReplayedSimulation};
use crate::report::simulation_row::SimulationRow;
use image::{GenericImage, RgbImage};
use std::path::Path;

/// A refused plan: vermillion of Okabe and Ito.
const REFUSED: Rgb = [213, 94, 0];
/// Widths of lines, meters.
const PLAN_M: f64 = 0.5;
const REFUSED_M: f64 = 0.35;
const TRAIL_M: f64 = 0.2;
/// Columns and rows of a contact sheet.
const SHEET: (u32, u32) = (4, 2);
/// Space between its frames, pixels.
const GAP: u32 = 6;

/// The size of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// Side of the scene, pixels.
    pub pixels: u32,
    /// Side of the scene, meters.
    pub meters: f64,
}

/// A simulation ready for drawing.
#[derive(Debug)]
pub struct Film {
    row: SimulationRow,
    simulation: ReplayedSimulation,
    /// The recorded planning calls.
    calls: Vec<CallRecord>,
    view: BevView,
}

impl Film {
    /// Opens the replay of a simulation.
    pub fn open(run: &Path, choice: &SimulationChoice, look: Look) -> Result<Self, RenderError> {
        let (row, folder) = choice.find(run)?;
        let view = BevView::new(look.pixels, look.meters)?;
        let replay = Replay::read(&folder)?.ok_or_else(|| RenderError::NoReplay(words(&row)))?;
        Ok(Self { simulation: ReplayedSimulation::new(&replay)?, calls: calls_in(&folder)?, row, view })
    }

    /// Number of iterations.
    pub fn iterations(&self) -> usize {
        self.simulation.moments().len()
    }

    /// The iteration at a time in seconds.
    pub fn iteration_at(&self, at_s: f64) -> Result<usize, RenderError> {
        let moments = self.simulation.moments();
        let end_s = moments.last().map_or(0.0, |moment| moment.at_s);
        // Also true for NaN.
        if !(0.0..=end_s + 1e-9).contains(&at_s) {
            return Err(RenderError::Outside { at_s, end_s });
        }
        Ok(moments.partition_point(|moment| moment.at_s <= at_s + 1e-9).saturating_sub(1))
    }

    /// Draws an iteration; later ones than the last are the last.
    pub fn frame(&self, iteration: usize) -> RgbImage {
        let moments = self.simulation.moments();
        let iteration = iteration.min(moments.len().saturating_sub(1));
        let Some(moment) = moments.get(iteration) else { return RgbImage::new(self.view.pixels(), self.view.pixels()) };
        let scene = render_with_lines(&self.simulation.scene(moment), &self.view, &self.lines(iteration, moment));
        caption::below(&scene, &self.caption(iteration, moment))
    }

    /// Frames at equal intervals over the whole simulation, in one picture.
    pub fn sheet(&self) -> RgbImage {
        let (across, down) = SHEET;
        let count = across * down;
        let last = self.iterations().saturating_sub(1);
        let frames: Vec<RgbImage> = (0..count).map(|k| self.frame(last * k as usize / (count as usize - 1))).collect();
        let (width, height) = frames.first().map_or((0, 0), RgbImage::dimensions);
        let mut sheet = RgbImage::from_pixel(
            across * (width + GAP) - GAP,
            down * (height + GAP) - GAP,
            image::Rgb(Palette::color(BevElement::Lanes)),
        );
        for (k, frame) in frames.iter().enumerate() {
            let (column, line) = (k as u32 % across, k as u32 / across);
            // Each frame is inside by construction.
            let _ = sheet.copy_from(frame, column * (width + GAP), line * (height + GAP));
        }
        sheet
    }

    /// The trail of the ego, the refused plans, the active plan.
    fn lines(&self, iteration: usize, moment: &Moment) -> Vec<BevLine> {
        let ego = Palette::color(BevElement::Ego);
        let trail: Vec<Point> = self
            .simulation
            .moments()
            .iter()
            .take(iteration + 1)
            .map(|moment| moment.ego.rear_axle.position())
            .collect();
        let mut lines = vec![BevLine { points: trail, width: TRAIL_M, color: ego }];
        if let Some((call, attempts)) = self.simulation.call_at(iteration) {
            let driving = self.calls.get(call).and_then(|call| Some(call.accepted()?.0));
            let refused = attempts.iter().enumerate().filter(|(i, _)| Some(*i) != driving);
            lines.extend(refused.map(|(_, points)| BevLine {
                points: points.clone(),
                width: REFUSED_M,
                color: REFUSED,
            }));
        }
        lines.push(BevLine { points: moment.plan.clone(), width: PLAN_M, color: ego });
        lines
    }

    fn caption(&self, iteration: usize, moment: &Moment) -> Caption {
        let row = &self.row;
        let score = row.score.map_or_else(|| "-".to_owned(), |score| fixed(100.0 * score, 2));
        let now = format!("{:4.1} s  {:4.1} m/s", moment.at_s, moment.ego.velocity.x.abs());
        let call = self.simulation.call_at(iteration).and_then(|(call, _)| self.calls.get(call));
        Caption {
            title: format!("{}  {}  {}", row.scenario, row.planner, row.challenge.short_name()),
            now: format!("{now}  score {score}"),
            plan: call.map(plan_words).unwrap_or_default(),
        }
    }
}

/// The code of the plan that becomes active with a call, with Reflection's score.
fn plan_words(call: &CallRecord) -> Vec<String> {
    let Some((index, attempt)) = call.accepted() else {
        return vec![format!("no new plan: {}", call.decision.why().unwrap_or_default())];
    };
    let code = attempt.code.as_ref().map_or("", LineRecord::text);
    let scored = attempt.reflection.as_ref().map(|reflection| format!(", Reflection {}", fixed(reflection.score, 2)));
    vec![format!("attempt {}{}", index + 1, scored.unwrap_or_default()), code.to_owned()]
}
