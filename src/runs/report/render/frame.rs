//! The frames of a simulation.

use super::canvas::Canvas;
use super::caption::Caption;
use super::colors::COLORS;
use super::error::RenderError;
use super::find::{SimulationChoice, words};
use super::legend::{Entry, Legend};
use super::lettering::Lettering;
use super::scene::{self, DrawnScene, View};
use crate::report::call_record::{CallRecord, DecisionRecord, LineRecord, calls_in};
use crate::report::decision::recorded_words;
use crate::report::number::fixed;
use crate::report::replay::{Moment, Replay, ReplayedSimulation};
use crate::report::simulation_row::SimulationRow;
use image::{GenericImage, RgbImage};
use planagent_agent::environment::bev::BevView;
use planagent_world::geometry::Point;
use std::path::Path;

/// Columns and rows of a contact sheet.
const SHEET: (u32, u32) = (4, 2);
/// Space around the text and between the frames of a sheet: share of the side of a scene.
const MARGIN: f32 = 0.02;
/// Letters of legend and caption: share of the side of a scene, and their bounds, pixels.
const LETTERS: f32 = 0.0215;
const LETTERS_PX: (f32, f32) = (9.0, 22.0);
/// Pictures of fewer pixels a side have no legend.
const MIN_LEGEND_PX: u32 = 320;

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
    look: Look,
    legend: Legend,
    /// Height of the caption, the same in all frames, pixels.
    caption: f32,
}

impl Film {
    /// Opens the replay of a simulation.
    pub fn open(run: &Path, choice: &SimulationChoice, look: Look) -> Result<Self, RenderError> {
        let (row, folder) = choice.find(run)?;
        // The limits of a picture are those of the model's.
        BevView::new(look.pixels, look.meters)?;
        let folder = &folder.open()?;
        let replay = Replay::read(folder)?.ok_or_else(|| RenderError::NoReplay(words(&row)))?;
        let simulation = ReplayedSimulation::new(&replay);
        let calls = calls_in(folder)?;
        let layout = Layout::for_look(look);
        let legend = Legend::new(&[], layout.letters, layout.width());
        let mut film = Self {
            row,
            simulation,
            calls,
            look,
            legend,
            caption: 0.0,
        };
        film.measure();
        Ok(film)
    }

    /// Sets legend and height of the caption, so that all frames have one size.
    fn measure(&mut self) {
        let layout = Layout::for_look(self.look);
        let moments = || self.simulation.moments().iter().enumerate();
        let mut entries: Vec<Entry> = moments()
            .flat_map(|(i, moment)| Entry::all_in(&self.scene(i, moment)))
            .collect();
        entries.sort_unstable();
        entries.dedup();
        let captions = moments().map(|(i, moment)| {
            self.caption(i, moment)
                .height(layout.letters, layout.width())
        });
        let caption = captions.fold(0.0, f32::max);
        let shown = if self.look.pixels < MIN_LEGEND_PX {
            &[][..]
        } else {
            &entries
        };
        (self.legend, self.caption) = (Legend::new(shown, layout.letters, layout.width()), caption);
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
        Ok(moments
            .partition_point(|moment| moment.at_s <= at_s + 1e-9)
            .saturating_sub(1))
    }

    /// Draws an iteration with legend and caption; later ones than the last are the last.
    pub fn frame(&self, iteration: usize) -> RgbImage {
        self.drawn(iteration, true)
    }

    fn drawn(&self, iteration: usize, with_legend: bool) -> RgbImage {
        let moments = self.simulation.moments();
        let iteration = iteration.min(moments.len().saturating_sub(1));
        let Some(moment) = moments.get(iteration) else {
            return RgbImage::new(self.look.pixels, self.look.pixels);
        };
        let layout = Layout::for_look(self.look);
        let caption = self.caption(iteration, moment);
        let legend = with_legend.then_some(&self.legend);
        picture(
            &self.scene(iteration, moment),
            self.look,
            legend,
            &caption,
            self.caption,
            layout,
        )
    }

    /// Frames at equal intervals over the whole simulation in one picture, with one legend below.
    pub fn sheet(&self) -> RgbImage {
        let (across, down) = SHEET;
        let count = across * down;
        let last = self.iterations().saturating_sub(1);
        let frames: Vec<RgbImage> = (0..count)
            .map(|k| self.drawn(last * k as usize / (count as usize - 1), false))
            .collect();
        let (width, height) = frames.first().map_or((0, 0), RgbImage::dimensions);
        let layout = Layout::for_look(self.look);
        let gap = layout.margin.round() as u32;
        let wide = across * (width + gap) - gap;
        let legend = Legend::new(
            &self.legend.entries(),
            layout.letters,
            wide as f32 - 2.0 * layout.margin,
        );
        let below = legend.height()
            + if legend.height() > 0.0 {
                2.0 * layout.margin
            } else {
                0.0
            };
        let frames_high = down * (height + gap) - gap;
        let mut canvas = Canvas::new((wide, frames_high + below.ceil() as u32), COLORS.panel);
        legend.draw(
            &mut canvas,
            (layout.margin, frames_high as f32 + layout.margin),
        );
        let mut sheet = canvas.into_image();
        for (k, frame) in frames.iter().enumerate() {
            let (column, line) = (k as u32 % across, k as u32 / across);
            // Each frame is inside by construction.
            let _ = sheet.copy_from(frame, column * (width + gap), line * (height + gap));
        }
        sheet
    }

    fn scene<'a>(&'a self, iteration: usize, moment: &'a Moment) -> DrawnScene<'a> {
        let moments = self.simulation.moments().iter();
        let trail: Vec<Point> = moments
            .take(iteration + 1)
            .map(|moment| moment.ego.rear_axle.position())
            .collect();
        let mut refused = Vec::new();
        if let Some((call, attempts)) = self.simulation.call_at(iteration) {
            let record = self.calls.get(call);
            // A refused plan that is executed all the same is among the refused ones.
            let accepted = record.and_then(|record| match record.decision {
                DecisionRecord::Execute { attempt } => Some(attempt),
                _ => None,
            });
            let score = |i: usize| Some(record?.attempts.get(i)?.reflection.as_ref()?.score);
            let others = attempts
                .iter()
                .enumerate()
                .filter(|(i, path)| Some(*i) != accepted && !path.is_empty());
            refused.extend(others.map(|(i, path)| (path.clone(), score(i))));
        }
        DrawnScene {
            map: self.simulation.map(),
            ego: &moment.ego,
            objects: &moment.objects,
            lights: self.simulation.lights_at(iteration),
            trail,
            plan: &moment.plan,
            refused,
        }
    }

    fn caption(&self, iteration: usize, moment: &Moment) -> Caption {
        let row = &self.row;
        let score = row
            .score
            .map_or_else(|| "-".to_owned(), |score| fixed(100.0 * score, 2));
        let speed = moment.ego.velocity.x.abs();
        let call = self
            .simulation
            .call_at(iteration)
            .and_then(|(call, _)| self.calls.get(call));
        Caption {
            title: format!(
                "{}, {}, {}",
                row.scenario,
                row.planner,
                row.challenge.short_name()
            ),
            now: format!(
                "{:.1} s, {speed:.1} m/s, score of the simulation {score}",
                moment.at_s
            ),
            plan: call.map(plan_words).unwrap_or_default(),
        }
    }
}

/// Where the text of a picture stands.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    /// Side of the scene, pixels.
    side: f32,
    /// Space around the text, pixels.
    pub(super) margin: f32,
    /// Letters of legend and caption.
    pub(super) letters: Lettering,
}

impl Layout {
    /// The layout of a size.
    pub(super) fn for_look(look: Look) -> Self {
        let side = look.pixels as f32;
        let letters = Lettering::regular((LETTERS * side).clamp(LETTERS_PX.0, LETTERS_PX.1));
        Self {
            side,
            margin: (MARGIN * side).max(4.0),
            letters,
        }
    }

    /// Width of the text, pixels.
    pub(super) fn width(self) -> f32 {
        self.side - 2.0 * self.margin
    }
}

/// A scene with its legend and its caption of a given height. Both sides are even, as H.264
/// requires.
pub(super) fn picture(
    scene: &DrawnScene<'_>,
    look: Look,
    legend: Option<&Legend>,
    caption: &Caption,
    caption_height: f32,
    layout: Layout,
) -> RgbImage {
    let even = |side: u32| side + side % 2;
    let legend_height = legend.map_or(0.0, |legend| legend.height() + layout.margin);
    let text = layout.margin + legend_height + caption_height + layout.margin;
    let size = (even(look.pixels), even(look.pixels + text.ceil() as u32));
    let view = View::new(scene.ego, look.pixels, look.meters);
    // The scene is drawn on its own, so that nothing of it lies under the text.
    let mut drawing = Canvas::new((look.pixels, look.pixels), COLORS.ground);
    scene::draw(&mut drawing, scene, &view);
    let mut page = Canvas::new(size, COLORS.panel);
    let mut top = layout.side + layout.margin;
    if let Some(legend) = legend.filter(|legend| legend.height() > 0.0) {
        legend.draw(&mut page, (layout.margin, top));
        top += legend.height() + layout.margin;
    }
    caption.draw(
        &mut page,
        (layout.margin, top),
        layout.letters,
        layout.width(),
    );
    let mut image = page.into_image();
    // The scene fits by construction.
    let _ = image.copy_from(&drawing.into_image(), 0, 0);
    image
}

/// The decision of a call, and the code of the plan that becomes active with it.
fn plan_words(call: &CallRecord) -> Vec<String> {
    let code = call
        .accepted()
        .and_then(|(_, attempt)| attempt.code.as_ref())
        .map(|code| LineRecord::text(code).to_owned());
    std::iter::once(recorded_words(call)).chain(code).collect()
}
