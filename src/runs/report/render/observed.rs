//! What a planner sees as people see it: a picture without text, for programs that show it
//! themselves.

use super::call::planned_path;
use super::canvas::Canvas;
use super::colors::COLORS;
use super::frame::Look;
use super::scene::{DrawnScene, View, draw};
use crate::report::replay::DrawnMap;
use image::RgbImage;
use planagent_agent::environment::{BevError, BevView};
use planagent_world::geometry::Bounds;
use planagent_world::{SceneView, Trajectory};

/// The scene with its lights, the trail of its history and a plan, ego-centered, the ego's heading
/// up.
///
/// # Errors
/// When the picture would be too small or too large.
pub fn observed_picture(
    scene: &SceneView<'_>,
    plan: Option<&Trajectory>,
    look: Look,
) -> Result<RgbImage, BevError> {
    // The limits of a picture are those of the model's.
    BevView::new(look.pixels, look.meters)?;
    let bounds = Bounds::around(&[scene.ego.rear_axle.position()]).grown(look.meters);
    let map = DrawnMap::from_map(scene.map, scene.route, &bounds);
    let plan = plan.map(planned_path).unwrap_or_default();
    let drawn = DrawnScene {
        ego: scene.ego,
        objects: scene.objects,
        lights: map
            .starts()
            .filter_map(|(lane, start)| Some((start, scene.lights.status(lane)?)))
            .collect(),
        trail: scene
            .history
            .samples()
            .map(|sample| sample.ego.rear_axle.position())
            .collect(),
        plan: &plan,
        refused: Vec::new(),
        map: &map,
    };
    let mut canvas = Canvas::new((look.pixels, look.pixels), COLORS.ground);
    draw(
        &mut canvas,
        &drawn,
        &View::new(scene.ego, look.pixels, look.meters),
    );
    Ok(canvas.into_image())
}
