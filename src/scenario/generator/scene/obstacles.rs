//! What blocks the ego's lane.

use super::builder::TrafficBuilder;
use planagent_world::ObjectKind;

/// Closes the ego's lane about `ahead` meters before it, if that is a lane with room before the
/// next junction. True if the lane is closed.
pub(crate) fn close_ahead(builder: &mut TrafficBuilder<'_, '_>, ahead: f64) -> bool {
    let at = builder.ego().s + ahead;
    let span = builder.ego().track.span_at(at);
    let room = span.to - at - 10.0;
    let length = builder
        .rng
        .situation(|rng| rng.uniform(10.0, 45.0))
        .min(room);
    let closable = !span.connector && room > 8.0 && at - span.from > 16.0;
    if closable {
        let width = builder.roads().facts[span.lane.index()].map_or(3.4, |facts| facts.lane_width);
        builder.close_lane(span.lane, at - span.from, length, width);
    }
    closable
}

/// Parks a vehicle in the ego's lane `ahead` meters before it, `aside` meters to the right of the
/// centerline.
pub(crate) fn double_park(builder: &mut TrafficBuilder<'_, '_>, ahead: f64, aside: f64) {
    let pose = builder
        .ego()
        .track
        .pose_at(builder.ego().s + ahead)
        .translated(0.0, -aside);
    let (length, width) = if builder.rng.situation(|rng| rng.bool(0.75)) {
        (builder.rng.uniform(4.3, 5.2), 1.9)
    } else {
        (builder.rng.uniform(7.0, 10.0), 2.4)
    };
    builder.put_fixture(ObjectKind::Vehicle, pose, length, width);
}
