//! Who leads a proposal along its path (`tuplan_garage` `pdm_generator.py`).

use super::{Forecast, PdmPath};
use crate::geometry::{Corridor, OrientedBox, Polygon};
use crate::world::{LaneMap, PACIFICA, TrackedObject};

/// What a proposal stays behind.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LeadState {
    /// Progress of its rear along the path, metres.
    pub progress: f64,
    /// Its speed along the heading of the ego, m/s.
    pub velocity: f64,
    /// Length to be left behind it, metres.
    pub length_rear: f64,
}

/// The corridor of one path and what of the forecast may come into it.
pub(super) struct PathTraffic<'a> {
    path: &'a PdmPath,
    forecast: &'a Forecast,
    corridor: Corridor,
    red_lights: Vec<(f64, &'a Polygon)>,
}

/// Something in the corridor at one step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Blocking<'a> {
    progress: f64,
    obstacle: Obstacle<'a>,
}

#[derive(Debug, Clone, Copy)]
enum Obstacle<'a> {
    Track(TrackedObject),
    RedLight(&'a Polygon),
}

impl Obstacle<'_> {
    fn distance(&self, ego: &OrientedBox) -> f64 {
        match self {
            Self::Track(track) => track.shape.distance(ego),
            Self::RedLight(polygon) => polygon.distance_to_box(ego),
        }
    }
}

impl<'a> PathTraffic<'a> {
    /// The traffic on `path` from progress `from` to progress `to`, metres.
    pub(super) fn new(map: &'a LaneMap, path: &'a PdmPath, forecast: &'a Forecast, from: f64, to: f64) -> Self {
        let corridor = Corridor::with_square_caps(&path.substring(from, to), PACIFICA.width / 2.0);
        let polygons = forecast.red_lights().iter().map(|&lane| &map[lane].polygon);
        let red_lights = polygons
            .filter(|polygon| corridor.meets_polygon(polygon))
            .map(|polygon| (path.project(polygon.centroid()), polygon))
            .collect();
        Self { path, forecast, corridor, red_lights }
    }

    /// What is in the corridor after so many steps of 0.1 s.
    pub(super) fn blocking(&self, step: usize) -> Vec<Blocking<'a>> {
        let tracks = self.forecast.objects().iter().map(|object| object.track_at(step));
        let in_corridor = tracks.filter(|track| self.corridor.meets_box(&track.shape)).map(|track| Blocking {
            progress: self.path.project(track.shape.center.position()),
            obstacle: Obstacle::Track(track),
        });
        let red = self
            .red_lights
            .iter()
            .map(|&(progress, polygon)| Blocking { progress, obstacle: Obstacle::RedLight(polygon) });
        in_corridor.chain(red).collect()
    }

    /// Writes into `lead` who leads an ego at `progress`. What upstream does not set keeps the value that `lead` comes with:
    /// a red light leaves the velocity, a free road the velocity, an obstacle the length.
    pub(super) fn find_lead(&self, blocking: &[Blocking<'_>], progress: f64, lead: &mut LeadState) {
        let ego = PACIFICA.footprint(self.path.pose_at(progress));
        let ahead = blocking.iter().filter(|b| b.progress > progress);
        let nearest = ahead.map(|b| (b.obstacle.distance(&ego), b)).min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((distance, nearest)) = nearest else {
            lead.progress = self.path.length();
            lead.length_rear = PACIFICA.length() / 2.0;
            return;
        };
        lead.progress = progress + distance;
        if let Obstacle::Track(track) = nearest.obstacle {
            let along = (track.shape.center.heading - ego.center.heading).cos();
            lead.velocity = if track.kind.is_agent() { track.speed() * along } else { 0.0 };
        }
    }
}
