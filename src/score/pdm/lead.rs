//! The lead object of a proposal along its path (`tuplan_garage` `pdm_generator.py`).

use super::parameters::TRAJECTORY_STEPS;
use super::{Forecast, ForecastObject, PdmPath};
use planagent_world::geometry::{Corridor, OrientedBox, Point, Polygon, Pose, Vector};
use planagent_world::{LaneMap, PACIFICA, TrackedObject};

/// The lead object of a proposal.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LeadState {
    /// Progress of its rear along the path, meters.
    pub progress: f64,
    /// Its speed along the heading of the ego, m/s.
    pub velocity: f64,
    /// Length that stays free behind it, meters.
    pub length_rear: f64,
}

/// The corridor of one path and the forecast objects that may enter it.
pub(super) struct PathTraffic<'a> {
    path: &'a PdmPath,
    corridor: Corridor,
    /// In the order of the forecast.
    objects: Vec<Nearby<'a>>,
    red_lights: Vec<Blocking<'a>>,
}

/// An object near a corridor.
enum Nearby<'a> {
    /// It stands in the corridor.
    Standing(Blocking<'a>),
    /// It moves and may enter the corridor.
    Moving(&'a ForecastObject),
}

/// An object in the corridor at one step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Blocking<'a> {
    /// Of its center along the path, meters.
    progress: f64,
    obstacle: Obstacle<'a>,
}

#[derive(Debug, Clone, Copy)]
enum Obstacle<'a> {
    Track {
        track: TrackedObject,
        /// Half the diagonal of its box, meters.
        radius: f64,
    },
    RedLight(&'a Polygon),
}

impl Obstacle<'_> {
    /// A lower bound of the distance to a box around `center`, whose corners are `reach` away.
    fn min_distance(&self, center: Point, reach: f64) -> f64 {
        match self {
            Self::Track { track, radius } => {
                (track.shape.center.position() - center).norm() - radius - reach
            }
            Self::RedLight(polygon) => polygon.bounds().distance_squared(center).sqrt() - reach,
        }
    }

    fn distance(&self, ego: &OrientedBox) -> f64 {
        match self {
            Self::Track { track, .. } => track.shape.distance(ego),
            Self::RedLight(polygon) => polygon.distance_to_box(ego),
        }
    }
}

impl<'a> PathTraffic<'a> {
    /// The traffic on `path` from progress `from` to progress `to`, meters.
    pub(super) fn new(
        map: &'a LaneMap,
        path: &'a PdmPath,
        forecast: &'a Forecast,
        from: f64,
        to: f64,
    ) -> Self {
        let corridor = Corridor::with_square_caps(&path.substring(from, to), PACIFICA.width / 2.0);
        let polygons = forecast.red_lights().iter().map(|&lane| &map[lane].polygon);
        let red_lights = polygons
            .filter(|polygon| corridor.meets_polygon(polygon))
            .map(|polygon| Blocking {
                progress: path.project(polygon.centroid()),
                obstacle: Obstacle::RedLight(polygon),
            });
        let mut traffic = Self {
            path,
            red_lights: red_lights.collect(),
            corridor,
            objects: Vec::new(),
        };
        traffic.objects = forecast
            .objects()
            .iter()
            .filter_map(|object| traffic.nearby(object))
            .collect();
        traffic
    }

    fn nearby(&self, object: &'a ForecastObject) -> Option<Nearby<'a>> {
        if object.velocity == Vector::zeros() {
            return self.in_corridor(object, 0).map(Nearby::Standing);
        }
        let sweep = object
            .bounds_between(0, TRAJECTORY_STEPS)
            .grown(object.radius);
        self.corridor
            .bounds()
            .overlaps(&sweep)
            .then_some(Nearby::Moving(object))
    }

    fn in_corridor(&self, object: &ForecastObject, step: usize) -> Option<Blocking<'a>> {
        let track = object.track_at(step);
        self.corridor.meets_box(&track.shape).then(|| Blocking {
            progress: self.path.project(track.shape.center.position()),
            obstacle: Obstacle::Track {
                track,
                radius: object.radius,
            },
        })
    }

    /// The objects in the corridor after a number of steps of 0.1 s.
    pub(super) fn blocking(&self, step: usize) -> Vec<Blocking<'a>> {
        let objects = self.objects.iter().filter_map(|object| match object {
            Nearby::Standing(blocking) => Some(*blocking),
            Nearby::Moving(object) => self.in_corridor(object, step),
        });
        objects.chain(self.red_lights.iter().copied()).collect()
    }

    /// Writes the lead object of an ego at `progress` and `pose` into `lead`. As upstream, a red
    /// light and a free road leave the velocity in `lead` as it is, and an obstacle leaves the
    /// length.
    pub(super) fn find_lead(
        &self,
        blocking: &[Blocking<'_>],
        progress: f64,
        pose: Pose,
        lead: &mut LeadState,
    ) {
        let ego = PACIFICA.footprint(pose);
        let (center, reach) = (ego.center.position(), ego.diagonal() / 2.0);
        let mut nearest: Option<(f64, &Obstacle<'_>)> = None;
        for Blocking { obstacle, .. } in blocking.iter().filter(|b| b.progress > progress) {
            let known = nearest.map_or(f64::INFINITY, |(distance, _)| distance);
            // The exact distance of two boxes is slow; a lower bound rules out most obstacles.
            if obstacle.min_distance(center, reach) <= known {
                let distance = obstacle.distance(&ego);
                if distance < known {
                    nearest = Some((distance, obstacle));
                }
            }
        }
        let Some((distance, obstacle)) = nearest else {
            lead.progress = self.path.length();
            lead.length_rear = PACIFICA.length() / 2.0;
            return;
        };
        lead.progress = progress + distance;
        if let Obstacle::Track { track, .. } = obstacle {
            let along = (track.shape.center.heading - ego.center.heading).cos();
            lead.velocity = if track.kind.is_agent() {
                track.speed() * along
            } else {
                0.0
            };
        }
    }
}
