//! Which forecast objects proposals may meet, step by step.

use super::{Forecast, ForecastObject, Placed};
use planagent_world::geometry::{Bounds, OrientedBox};
use planagent_world::{PACIFICA, STEP_S, TrackedObject};

/// Steps by which the ego is projected in the test of the time to collision: 0, 0.3, 0.6, 0.9 s.
pub(super) const PROJECTED_STEPS: [usize; 4] = [0, 3, 6, 9];

/// For each step of a batch of proposals the objects that come near any of them, in the order of
/// the forecast.
pub(super) struct Encounters<'a> {
    near: Vec<Vec<&'a ForecastObject>>,
    /// From the center of the ego's box to its corners, meters.
    radius: f64,
}

impl<'a> Encounters<'a> {
    /// The objects near the proposals at each step and within 0.9 s of it straight ahead.
    pub(super) fn from_forecast(forecast: &'a Forecast, batch: &[Vec<Placed>]) -> Self {
        let steps = batch.iter().map(Vec::len).max().unwrap_or(0);
        let last = PROJECTED_STEPS[PROJECTED_STEPS.len() - 1];
        let radius = PACIFICA.length().hypot(PACIFICA.width) / 2.0;
        let near = (0..steps).map(|step| {
            let places = batch.iter().filter_map(|placed| placed.get(step));
            let reach = places.fold(Bounds::around(&[]), |reach, placed| {
                let ends = [placed.shape, placed.moved(last as f64 * STEP_S)]
                    .map(|shape| shape.center.position());
                reach.joined(Bounds::around(&ends).grown(radius))
            });
            let comes_near = |object: &&ForecastObject| {
                object
                    .bounds_between(step, step + last)
                    .grown(object.radius)
                    .overlaps(&reach)
            };
            forecast.objects().iter().filter(comes_near).collect()
        });
        Self {
            near: near.collect(),
            radius,
        }
    }

    /// Whether no object comes near at a step or within 0.9 s of it.
    pub(super) fn is_clear(&self, step: usize) -> bool {
        self.near[step].is_empty()
    }

    /// The objects whose forecast box `ahead` steps after a step meets `shape`, a box of the ego,
    /// as they are forecast then.
    pub(super) fn touching<'s>(
        &'s self,
        shape: &'s OrientedBox,
        step: usize,
        ahead: usize,
    ) -> impl Iterator<Item = TrackedObject> + 's {
        let radius = self.radius;
        let center = shape.center.position();
        let near = self.near[step].iter().filter(move |object| {
            (object.center_at(step + ahead) - center).norm_squared()
                < (object.radius + radius).powi(2)
        });
        near.map(move |object| object.track_at(step + ahead))
            .filter(move |track| shape.overlaps(&track.shape))
    }
}
