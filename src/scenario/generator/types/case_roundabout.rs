//! First qualitative case of the paper: a vehicle waits at the entry of a roundabout, and the lane
//! beside is free.

use crate::generator::prelude::*;

/// `case_roundabout`.
pub(super) const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "case_roundabout",
    seed: 17_000,
    group: TypeGroup::Case,
    setting,
    populate,
    shows: |log| log.changes_lane() && log.in_intersection(),
});

/// Speed limit, m/s (25 mph).
const LIMIT: f64 = 11.2;

fn setting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let style = setting::style(rng, [2, 2], [2, 2], &[LIMIT]);
    let before = rng.uniform(76.0, 84.0);
    let (layout, start) = setting::roundabout(rng, &style, before)?;
    let mut setting = Setting::new(layout, start, rng.uniform(0.7, 0.8));
    setting.lane = LanePick::Rightmost;
    Ok(setting)
}

fn populate(builder: &mut TrafficBuilder<'_, '_>) {
    let track = builder.ego().track.clone();
    let entry = track
        .spans
        .iter()
        .find(|span| span.connector && span.from > builder.ego().s)
        .map(|span| span.from);
    if let Some(waiting) =
        entry.and_then(|entry| builder.put_on(VehicleKind::Car, track, entry - 3.6, 0.0, 0.0))
    {
        // It takes no gap during the scenario. The expert passes whatever stands permanently, but
        // must not know of this vehicle before iteration 0.
        builder.traffic.movers[waiting].speed_cap = 0.3;
        builder.traffic.movers[waiting].script = vec![Act::Limit {
            at: 0.0,
            speed: 0.05,
        }];
    }
    let density = builder.rng.uniform(0.2, 0.4);
    builder.fill_lanes_to(density, [110.0, 40.0]);
    builder.add_clutter();
}
