//! Puts vehicles, objects and pedestrians on the roads.

use super::habits::Habits;
use super::setting::{LEAD_IN, LanePick, LightTiming, Setting};
use super::wide;
use crate::generator::expert::{EXPERT, ExpertTask};
use crate::generator::rng::SeededRng;
use crate::generator::road::Roads;
use crate::generator::traffic::{DriverProfile, Mover, Shift, Track, Traffic, Walker};
use planagent_world::geometry::{OrientedBox, Polygon, Pose};
use planagent_world::{LaneId, ObjectKind, SignalStatus, TrackToken, TrackedObject};
use std::sync::Arc;

/// Size of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VehicleKind {
    /// A passenger car or van.
    Car,
    /// A truck or bus.
    Long,
    /// A bicycle.
    Bicycle,
}

/// Puts agents and objects on the roads; the ego is there from the start.
pub struct TrafficBuilder<'a, 'd> {
    /// Random numbers of the scene.
    pub rng: &'d mut SeededRng,
    /// The ego is the first mover.
    pub(crate) traffic: Traffic<'a>,
    /// Index of the ego's lane on the first road, 0 the leftmost.
    pub(crate) ego_lane: usize,
    pub(crate) task: ExpertTask,
    pub(super) habits: Habits,
    tokens: u32,
}

/// Sets the traffic lights and picks the ego's lane: its chain of lanes, and its index on the first
/// road.
pub(crate) fn prepare(
    roads: &mut Roads,
    setting: &Setting,
    rng: &mut SeededRng,
) -> (Vec<LaneId>, usize) {
    let first = &roads.route_lanes[0];
    let best = first
        .iter()
        .map(|&lane| roads.reach(0, lane))
        .max()
        .expect("a road has one lane at least");
    let good: Vec<usize> = (0..first.len())
        .filter(|&i| roads.reach(0, first[i]) == best)
        .collect();
    let place = match setting.lane {
        LanePick::OnRoute => rng.situation(|rng| rng.choose(&good)),
        LanePick::Rightmost => good[good.len() - 1],
        LanePick::AnyLane => rng.situation(|rng| rng.range(0, first.len() - 1)),
    };
    let chain = roads.chain_on_route(0, first[place]);
    for n in 0..roads.signals.len() {
        let governed: Vec<LaneId> = roads.signals[n].connectors().collect();
        let own = chain.iter().copied().find(|lane| governed.contains(lane));
        // A setting times the first light on the way only: when the ego reaches the next one
        // depends on the traffic.
        let is_first = own.is_some_and(|own| {
            let before = chain.iter().take_while(|&&lane| lane != own);
            !before
                .into_iter()
                .any(|lane| roads.map[*lane].has_traffic_lights)
        });
        let connector = own.unwrap_or(governed[0]);
        match setting.light {
            LightTiming::GreenFrom(time) if is_first => {
                roads.signals[n].start_green_at(connector, rng.value_of(time));
            }
            LightTiming::GreenUntil(time) if is_first => {
                roads.signals[n].end_green_at(connector, rng.value_of(time));
            }
            _ => roads.signals[n].start_green_at(connector, rng.uniform(0.0, 40.0)),
        }
    }
    (chain, place)
}

/// A driver's temper, from timid to aggressive.
pub(super) fn driver_profile(rng: &mut SeededRng) -> DriverProfile {
    let boldness = rng.unit();
    let mix = |timid: f64, bold: f64| timid + (bold - timid) * boldness;
    DriverProfile {
        speed_factor: mix(0.8, 1.08),
        min_gap: mix(3.0, 1.5),
        headway: mix(1.9, 0.8),
        accel: mix(1.0, 2.4),
        decel: mix(1.6, 3.0),
        gap_margin: mix(2.5, 0.8),
        jerk: mix(2.5, 6.0),
        max_braking: 7.0,
        steering: None,
    }
}

impl<'a, 'd> TrafficBuilder<'a, 'd> {
    /// The ego alone; `None` if its lanes give no track.
    pub(crate) fn new(
        roads: &'a Roads,
        chain: Vec<LaneId>,
        ego_lane: usize,
        setting: &Setting,
        rng: &'d mut SeededRng,
    ) -> Option<Self> {
        let track = Arc::new(Track::along(roads, chain)?);
        let speed = setting.start_speed * track.allowed_at(setting.start_s) * EXPERT.speed_factor;
        let ego = Mover::ego(track, setting.start_s, speed, EXPERT);
        let traffic = Traffic {
            roads,
            movers: vec![ego],
            walkers: Vec::new(),
            fixtures: Vec::new(),
            time: -LEAD_IN,
        };
        Some(Self {
            habits: Habits::new(rng),
            rng,
            traffic,
            ego_lane,
            task: setting.task,
            tokens: 0,
        })
    }

    pub(crate) fn roads(&self) -> &'a Roads {
        self.traffic.roads
    }

    pub(crate) fn ego(&self) -> &Mover {
        &self.traffic.movers[0]
    }

    /// A car with a probability of 85 %, else a long vehicle; a draw of the situation.
    pub(crate) fn mostly_a_car(&mut self) -> VehicleKind {
        if self.rng.situation(|rng| rng.bool(0.85)) {
            VehicleKind::Car
        } else {
            VehicleKind::Long
        }
    }

    pub(crate) fn car_or_long(&mut self, long: f64) -> VehicleKind {
        if self.rng.bool(long) {
            VehicleKind::Long
        } else {
            VehicleKind::Car
        }
    }

    /// Speed of the ego when the traffic starts, m/s.
    pub fn ego_speed(&self) -> f64 {
        self.ego().speed
    }

    /// The crosswalk that covers this part of the ego's track.
    pub(crate) fn crosswalk_at(&self, span: [f64; 2]) -> Option<Polygon> {
        let at = self
            .ego()
            .track
            .pose_at(f64::midpoint(span[0], span[1]))
            .position();
        self.roads()
            .map
            .crosswalks()
            .iter()
            .find(|walk| walk.contains(at))
            .cloned()
    }

    fn token(&mut self) -> TrackToken {
        self.tokens += 1;
        TrackToken(self.tokens)
    }

    /// Length and width of a vehicle, meters.
    fn size(&mut self, kind: VehicleKind) -> (f64, f64) {
        if self.rng.is_wide() {
            return wide::size(self.rng, kind, self.habits);
        }
        match kind {
            VehicleKind::Car => (self.rng.uniform(4.2, 5.3), self.rng.uniform(1.8, 2.1)),
            VehicleKind::Long => (self.rng.uniform(8.5, 13.0), self.rng.uniform(2.4, 2.6)),
            VehicleKind::Bicycle => (1.8, 0.65),
        }
    }

    /// Puts a vehicle on a chain of lanes with its center at `s` meters. Gives its index among the
    /// movers, or `None` if the place is taken.
    pub(crate) fn put(
        &mut self,
        kind: VehicleKind,
        chain: Vec<LaneId>,
        s: f64,
        speed: f64,
        lateral: f64,
    ) -> Option<usize> {
        let track = Arc::new(Track::along(self.roads(), chain)?);
        self.put_on(kind, track, s, speed, lateral)
    }

    /// Puts a vehicle on a track; see [`Self::put`].
    pub(crate) fn put_on(
        &mut self,
        kind: VehicleKind,
        track: Arc<Track>,
        s: f64,
        speed: f64,
        lateral: f64,
    ) -> Option<usize> {
        let ((length, width), profile) = (self.size(kind), driver_profile(self.rng));
        if s < length / 2.0 + 1.0 || s + length / 2.0 + 3.0 > track.length() {
            return None;
        }
        let sideways = self.rng.is_wide().then(|| {
            wide::sideways(
                self.rng,
                kind,
                width,
                self.lane_width_at(&track, s),
                self.habits,
            )
        });
        let mover = Mover {
            token: TrackToken(0),
            kind: if kind == VehicleKind::Bicycle {
                ObjectKind::Bicycle
            } else {
                ObjectKind::Vehicle
            },
            length,
            width,
            front: length / 2.0,
            track,
            s,
            speed: speed.max(0.0),
            accel: 0.0,
            shift: Shift::constant(lateral + sideways.map_or(0.0, |(aside, _)| aside)),
            sway: sideways.and_then(|(_, sway)| sway),
            profile,
            speed_cap: f64::INFINITY,
            stop_s: None,
            script: Vec::new(),
            served: None,
            gone: false,
        };
        // After the draws, since whether there is room depends on the drawn size and sideways
        // place.
        if !self.is_free(&mover.shape(), 2.5, 0.15) {
            return None;
        }
        let token = self.token();
        self.traffic.movers.push(Mover { token, ..mover });
        Some(self.traffic.movers.len() - 1)
    }

    /// Puts a vehicle on the ego's track with a gap of `gap` meters between the bumpers. Gives its
    /// index among the movers.
    pub fn put_ahead(&mut self, kind: VehicleKind, gap: f64, speed: f64) -> Option<usize> {
        let (track, front) = (self.ego().track.clone(), self.ego().front_s());
        // The length is not known yet; this leaves room for half a vehicle.
        let half = if kind == VehicleKind::Long { 5.4 } else { 2.4 };
        self.put_on(kind, track, front + gap + half, speed, 0.0)
    }

    /// True if a box with these margins on every side touches nothing.
    fn is_free(&self, shape: &OrientedBox, along: f64, across: f64) -> bool {
        let grown = OrientedBox::new(
            shape.center,
            shape.length + 2.0 * along,
            shape.width + 2.0 * across,
        );
        let movers = self.traffic.movers.iter().map(Mover::shape);
        movers
            .chain(self.traffic.fixtures.iter().map(|f| f.shape))
            .all(|other| !other.overlaps(&grown))
            && self
                .traffic
                .walkers
                .iter()
                .all(|walker| !walker.shape().overlaps(&grown))
    }

    /// Puts a static object; true if there was room.
    pub(crate) fn put_fixture(
        &mut self,
        kind: ObjectKind,
        center: Pose,
        length: f64,
        width: f64,
    ) -> bool {
        let shape = OrientedBox::new(center, length, width);
        let free = self.is_free(&shape, 0.3, 0.1);
        if free {
            let token = self.token();
            let velocity = planagent_world::geometry::Vector::zeros();
            self.traffic.fixtures.push(TrackedObject {
                token,
                kind,
                shape,
                velocity,
            });
        }
        free
    }

    pub(crate) fn put_walker(&mut self, walker: Walker) {
        let token = self.token();
        self.traffic.walkers.push(Walker { token, ..walker });
    }

    /// A chain of lanes from `lane` with random turns.
    pub(crate) fn wander(&mut self, lane: LaneId) -> Vec<LaneId> {
        let roads = self.roads();
        let mut chain = vec![lane];
        while chain.len() < 9 {
            let onward = &roads.map[chain[chain.len() - 1]].outgoing;
            if onward.is_empty() {
                break;
            }
            let next = self.rng.choose(onward);
            if chain.contains(&next) {
                break;
            }
            chain.push(next);
        }
        chain
    }

    /// As [`Self::fill_lanes_to`] with a density that the situation draws within bounds.
    pub(crate) fn fill_lanes(&mut self, density: [f64; 2], clear: [f64; 2]) {
        let density = self
            .rng
            .situation(|rng| rng.uniform(density[0], density[1]));
        self.fill_lanes_to(density, clear);
    }

    /// Fills all lanes with vehicles, on average `density` per hundred meters of lane. In the ego's
    /// lane, none is nearer than `clear` meters ahead and behind.
    pub(crate) fn fill_lanes_to(&mut self, density: f64, clear: [f64; 2]) {
        let max_movers = if self.rng.is_wide() {
            wide::MAX_MOVERS
        } else {
            34
        };
        let density = if self.rng.is_wide() {
            wide::density(self.rng, density)
        } else {
            density
        };
        if self.rng.is_wide() {
            self.queue_at_lines();
        }
        let lanes: Vec<LaneId> = self.roads().road_lanes().collect();
        let ego = self.ego().clone();
        for lane in lanes {
            let length = self.roads().map[lane].centerline.length();
            let mut s = self.rng.uniform(4.0, 30.0 + 40.0 / density.max(0.2));
            while s < length - 4.0 && self.traffic.movers.len() < max_movers {
                let spacing =
                    9.0 + self.rng.uniform(0.2, 1.8) * (100.0 / density.max(0.05) - 9.0).max(0.0);
                let at = self.roads().map[lane].centerline.point_at(s);
                let (along, lateral) = ego.track.project(at, ego.s - 80.0, ego.s + 120.0);
                let near = (at - ego.track.pose_at(along).position()).norm();
                let in_own_lane = lateral.abs() < 2.0 && near < 3.0;
                let ahead = along - ego.s;
                if !(in_own_lane && ahead > -clear[1] && ahead < clear[0]) {
                    // Draws of a vehicle come only where one may stand. Their order is part of what
                    // a seed means.
                    let kind = if self
                        .rng
                        .bool(if self.rng.is_wide() { wide::LONG } else { 0.1 })
                    {
                        VehicleKind::Long
                    } else {
                        VehicleKind::Car
                    };
                    let chain = self.wander(lane);
                    self.put_settled(kind, chain, s);
                }
                s += spacing;
            }
        }
    }

    /// Width of the lane of a track at `s`, meters.
    fn lane_width_at(&self, track: &Track, s: f64) -> f64 {
        self.roads().facts[track.span_at(s).lane.index()].map_or(3.2, |facts| facts.lane_width)
    }

    /// Puts a vehicle with a speed that suits the road ahead of it.
    fn put_settled(&mut self, kind: VehicleKind, chain: Vec<LaneId>, s: f64) {
        let Some(track) = Track::along(self.roads(), chain).map(Arc::new) else {
            return;
        };
        let lights = self.traffic.lights();
        let allowed = track.allowed_at(s) * self.rng.uniform(0.7, 1.0);
        let roads = self.roads();
        let halt = track
            .spans
            .iter()
            .filter(|span| span.connector && span.from > s)
            .find(|span| {
                let passage = roads.passages[span.lane.index()].as_ref();
                match lights.status(span.lane) {
                    Some(status) => status != SignalStatus::Green,
                    None => {
                        passage.is_some_and(|p| p.stop_sign || p.conflicts.iter().any(|c| c.yields))
                    }
                }
            });
        let room = halt.map_or(f64::INFINITY, |span| (span.from - s - 6.0).max(0.0));
        let speed = allowed.min((2.0 * 1.4 * room).sqrt());
        self.put_on(kind, track, s, speed, 0.0);
    }

    /// Slows down every vehicle that could not brake comfortably behind a slower one ahead.
    fn settle(&mut self) {
        /// Comfortable braking, m/s².
        const BRAKING: f64 = 1.3;
        for _ in 0..3 {
            let bodies = self.traffic.bodies();
            for i in 1..self.traffic.movers.len() {
                let me = &self.traffic.movers[i];
                let mut speed = me.speed;
                for body in bodies.iter().filter(|body| body.mover != Some(i)) {
                    let (s, lateral) =
                        me.track
                            .project(body.shape.center.position(), me.s, me.s + 70.0);
                    let place = me.track.pose_at(s);
                    let near = (place.position() - body.shape.center.position()).norm();
                    if s <= me.s + 0.5
                        || lateral.abs() > f64::midpoint(me.width, body.shape.width)
                        || near > 3.0
                    {
                        continue;
                    }
                    let gap = (s - body.shape.length / 2.0 - me.front_s() - 2.0).max(0.0);
                    let ahead = (body.direction.dot(&place.direction()) * body.speed).max(0.0);
                    speed = speed.min((ahead * ahead + 2.0 * BRAKING * gap).sqrt());
                }
                self.traffic.movers[i].speed = speed;
            }
        }
    }

    /// The traffic, ready to start, and the ego's task.
    pub(crate) fn finish(mut self) -> (Traffic<'a>, ExpertTask) {
        self.settle();
        (self.traffic, self.task)
    }
}
