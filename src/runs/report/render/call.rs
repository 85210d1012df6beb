//! One planning call as a picture: the scene as people see it, and beside it the model's own
//! picture.

use super::canvas::Canvas;
use super::caption::Caption;
use super::colors::COLORS;
use super::frame::{Layout, Look, picture};
use super::legend::{Entry, Legend};
use super::lettering::Lettering;
use super::scene::DrawnScene;
use crate::report::decision::decision_words;
use crate::report::number::fixed;
use crate::report::replay::DrawnMap;
use image::imageops::{self, FilterType};
use image::{GenericImage, RgbImage};
use planagent_agent::environment::bev::Palette;
use planagent_agent::planner::{Decision, PlanningCall};
use planagent_agent::reflection::{ReflectionReport, Verdict};
use planagent_scenario::{Frame, Scenario};
use planagent_world::geometry::{Bounds, Point};
use planagent_world::{MICROS_PER_SECOND, STEP_S, Trajectory};

/// The scene of a call: 640 pixels for 64 m.
const LOOK: Look = Look {
    pixels: 640,
    meters: 64.0,
};
/// Space between the points of a plan, seconds, and of a roll-out, steps.
const PLAN_STEP_S: f64 = 0.5;
const ROLLOUT_STEP: usize = 5;

/// The picture of a call at an iteration of a scenario. Without a picture of the model there is
/// only the scene.
pub fn call_picture(
    scenario: &Scenario,
    frame: &Frame,
    call: &PlanningCall,
    plan: &Trajectory,
) -> RgbImage {
    let layout = Layout::for_look(LOOK);
    // A refused plan that is executed all the same is among the refused ones.
    let is_accepted =
        |i: usize| matches!(call.decision, Decision::Execute(attempt) if attempt == i);
    let refused = call
        .attempts
        .iter()
        .enumerate()
        .filter(|(i, _)| !is_accepted(*i));
    let refused = refused
        .filter_map(|(_, attempt)| attempt.reflection.as_ref())
        .map(refused_path)
        .collect();
    let caption = caption(scenario, call, frame.ego.speed());
    let own = scene_picture(
        scenario,
        frame,
        call.iteration,
        &planned_path(plan),
        refused,
        &caption,
    );
    match call.image.as_deref() {
        Some(image) => beside(&own, image, layout),
        None => own,
    }
}

/// The picture of a plan that was judged at an iteration of a scenario: its roll-out, as executed
/// or as refused; `words` stand below.
pub fn code_picture(
    scenario: &Scenario,
    frame: &Frame,
    iteration: usize,
    report: &ReflectionReport,
    words: Vec<String>,
) -> RgbImage {
    let (path, score) = refused_path(report);
    let (plan, refused) = match report.verdict {
        Verdict::Execute => (path, Vec::new()),
        Verdict::Rethink => (Vec::new(), vec![(path, score)]),
    };
    let caption = caption_of(
        scenario,
        iteration as f64 * STEP_S,
        frame.ego.speed(),
        words,
    );
    scene_picture(scenario, frame, iteration, &plan, refused, &caption)
}

/// A plan, a point every half second.
pub(super) fn planned_path(plan: &Trajectory) -> Vec<Point> {
    let count = (plan.duration_s() / PLAN_STEP_S) as usize;
    let at =
        |k: usize| plan.at(plan.start_us() + (k as f64 * PLAN_STEP_S * MICROS_PER_SECOND) as i64);
    (0..=count)
        .map_while(|k| Some(at(k).ok()?.rear_axle.position()))
        .collect()
}

/// A roll-out, a point every half second, with its score.
fn refused_path(report: &ReflectionReport) -> (Vec<Point>, Option<f64>) {
    let states = report.states.iter().step_by(ROLLOUT_STEP);
    (
        states.map(|state| state.rear_axle.position()).collect(),
        Some(report.score),
    )
}

fn scene_picture(
    scenario: &Scenario,
    frame: &Frame,
    iteration: usize,
    plan: &[Point],
    refused: Vec<(Vec<Point>, Option<f64>)>,
    caption: &Caption,
) -> RgbImage {
    let ego = &frame.ego;
    let bounds = Bounds::around(&[ego.rear_axle.position()]).grown(LOOK.meters);
    let map = DrawnMap::from_map(&scenario.map, &scenario.route, &bounds);
    // The present frame belongs to the trail, which ends at the ego.
    let past = scenario
        .frames
        .iter()
        .skip(scenario.start)
        .take(iteration + 1);
    let scene = DrawnScene {
        ego,
        objects: &frame.objects,
        lights: map
            .starts()
            .filter_map(|(lane, start)| Some((start, frame.lights.status(lane)?)))
            .collect(),
        trail: past.map(|frame| frame.ego.rear_axle.position()).collect(),
        plan,
        refused,
        map: &map,
    };
    let layout = Layout::for_look(LOOK);
    let legend = Legend::new(&Entry::all_in(&scene), layout.letters, layout.width());
    let height = caption.height(layout.letters, layout.width());
    picture(&scene, LOOK, Some(&legend), caption, height, layout)
}

fn caption(scenario: &Scenario, call: &PlanningCall, speed: f64) -> Caption {
    let code = call
        .decision
        .attempt()
        .and_then(|index| call.attempts.get(index)?.line());
    caption_of(
        scenario,
        call.at_s,
        speed,
        std::iter::once(decision_words(call)).chain(code).collect(),
    )
}

fn caption_of(scenario: &Scenario, at_s: f64, speed: f64, plan: Vec<String>) -> Caption {
    let now = format!("{} s, {} m/s", fixed(at_s, 1), fixed(speed, 1));
    Caption {
        title: scenario.id.clone(),
        now,
        plan,
    }
}

/// A picture with the model's own at its right, enlarged so that its pixels show.
fn beside(own: &RgbImage, image: &RgbImage, layout: Layout) -> RgbImage {
    let side = image.width().max(image.height()).max(1);
    let times = (LOOK.pixels / side).max(1);
    let (width, height) = (image.width() * times, image.height() * times);
    let enlarged = imageops::resize(image, width, height, FilterType::Nearest);
    let gap = layout.margin.round() as u32;
    let words = format!(
        "What the model sees: {} x {} pixels. {}",
        image.width(),
        image.height(),
        Palette::legend()
    );
    let letters = Lettering::regular(layout.letters.size);
    let lines = letters.wrapped(&words, width as f32 - layout.margin);
    let text = height as f32 + layout.margin + lines.len() as f32 * letters.line() + layout.margin;
    let even = |side: u32| side + side % 2;
    let size = (
        even(own.width() + gap + width),
        even(own.height().max(text.ceil() as u32)),
    );
    let mut canvas = Canvas::new(size, COLORS.panel);
    for (i, line) in lines.iter().enumerate() {
        let baseline = height as f32 + layout.margin + i as f32 * letters.line() + letters.size;
        canvas.text(
            line,
            ((own.width() + gap) as f32, baseline),
            letters,
            COLORS.ink_soft,
        );
    }
    let mut both = canvas.into_image();
    // Both fit by construction.
    let _ = both.copy_from(own, 0, 0);
    let _ = both.copy_from(&enlarged, own.width() + gap, 0);
    both
}
