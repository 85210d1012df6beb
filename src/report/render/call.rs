//! One planning call as a picture: the scene as people see it, and beside it the model's own picture.

use super::canvas::Canvas;
use super::caption::Caption;
use super::colors::COLORS;
use super::frame::{Layout, Look, picture};
use super::legend::{Entry, Legend};
use super::lettering::Lettering;
use super::scene::DrawnScene;
use crate::environment::bev::Palette;
use crate::geometry::{Bounds, Point};
use crate::planner::PlanningCall;
use crate::report::decision::decision_words;
use crate::report::number::fixed;
use crate::report::replay::DrawnMap;
use crate::scenario::{Frame, Scenario};
use crate::world::{MICROS_PER_SECOND, Trajectory};
use image::imageops::{self, FilterType};
use image::{GenericImage, RgbImage};

/// The scene of a call: 640 pixels for 64 m.
const LOOK: Look = Look { pixels: 640, meters: 64.0 };
/// Space between the points of a plan, seconds, and of a roll-out, steps.
const PLAN_STEP_S: f64 = 0.5;
const ROLLOUT_STEP: usize = 5;

/// The picture of a call at an iteration of a scenario. Without a picture of the model there is only the scene.
pub fn call_picture(scenario: &Scenario, frame: &Frame, call: &PlanningCall, plan: &Trajectory) -> RgbImage {
    let layout = Layout::of(LOOK);
    let own = plan_scene(scenario, frame, call, plan, &|scene| {
        let legend = Legend::new(&Entry::of(scene), layout.letters, layout.width());
        let caption = caption(scenario, call, scene.ego.speed());
        let height = caption.height(layout.letters, layout.width());
        picture(scene, LOOK, Some(&legend), &caption, height, layout)
    });
    match call.image.as_deref() {
        Some(image) => beside(&own, image, layout),
        None => own,
    }
}

/// Calls `draw` with the scene of a call.
fn plan_scene<T>(
    scenario: &Scenario,
    frame: &Frame,
    call: &PlanningCall,
    plan: &Trajectory,
    draw: &dyn Fn(&DrawnScene<'_>) -> T,
) -> T {
    let ego = &frame.ego;
    let map = DrawnMap::of(scenario, &Bounds::around(&[ego.rear_axle.position()]).grown(LOOK.meters));
    let past = scenario.frames.iter().skip(scenario.start).take(call.iteration + 1);
    let count = (plan.duration_s() / PLAN_STEP_S) as usize;
    let at = |k: usize| plan.at(plan.start_us() + (k as f64 * PLAN_STEP_S * MICROS_PER_SECOND) as i64);
    let points: Vec<Point> = (0..=count).map_while(|k| Some(at(k).ok()?.rear_axle.position())).collect();
    let refused = call.attempts.iter().enumerate().filter(|(i, _)| Some(*i) != call.decision.attempt());
    let rolled_out = refused.filter_map(|(_, attempt)| attempt.reflection.as_ref()).map(|reflection| {
        let states = reflection.states.iter().step_by(ROLLOUT_STEP);
        (states.map(|state| state.rear_axle.position()).collect(), Some(reflection.score))
    });
    draw(&DrawnScene {
        ego,
        objects: &frame.objects,
        lights: map.starts().filter_map(|(lane, start)| Some((start, frame.lights.status(lane)?))).collect(),
        trail: past.map(|frame| frame.ego.rear_axle.position()).collect(),
        plan: &points,
        refused: rolled_out.collect(),
        map: &map,
    })
}

fn caption(scenario: &Scenario, call: &PlanningCall, speed: f64) -> Caption {
    let code = call.decision.attempt().and_then(|index| call.attempts.get(index)?.line());
    Caption {
        title: scenario.id.clone(),
        now: format!("{} s, {} m/s", fixed(call.at_s, 1), fixed(speed, 1)),
        plan: std::iter::once(decision_words(call)).chain(code).collect(),
    }
}

/// A picture with the model's own at its right, enlarged so that its pixels show.
fn beside(own: &RgbImage, image: &RgbImage, layout: Layout) -> RgbImage {
    let side = image.width().max(image.height()).max(1);
    let times = (LOOK.pixels / side).max(1);
    let (width, height) = (image.width() * times, image.height() * times);
    let enlarged = imageops::resize(image, width, height, FilterType::Nearest);
    let gap = layout.margin.round() as u32;
    let words = format!("What the model sees: {} x {} pixels. {}", image.width(), image.height(), Palette::legend());
    let letters = Lettering::regular(layout.letters.size);
    let lines = letters.wrapped(&words, width as f32 - layout.margin);
    let text = height as f32 + layout.margin + lines.len() as f32 * letters.line() + layout.margin;
    let even = |side: u32| side + side % 2;
    let size = (even(own.width() + gap + width), even(own.height().max(text.ceil() as u32)));
    let mut canvas = Canvas::new(size, COLORS.panel);
    for (i, line) in lines.iter().enumerate() {
        let baseline = height as f32 + layout.margin + i as f32 * letters.line() + letters.size;
        canvas.text(line, ((own.width() + gap) as f32, baseline), letters, COLORS.ink_soft);
    }
    let mut both = canvas.into_image();
    // Both fit by construction.
    let _ = both.copy_from(own, 0, 0);
    let _ = both.copy_from(&enlarged, own.width() + gap, 0);
    both
}
