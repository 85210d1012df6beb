//! The ego passes a bay at the curb where people get in and out of cars.

use crate::generator::prelude::*;

/// `traversing_pickup_dropoff`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "traversing_pickup_dropoff",
    seed: 8_000,
    group: TypeGroup::Nuplan14,
    setting,
    populate,
    shows: |log| log.passes_bay(),
});

fn setting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let mut style = setting::style(rng, [1, 3], [0, 2], &LIMITS[..3]);
    style.shoulder[0] = rng.uniform(0.5, 0.8);
    let start = setting::anywhere(rng);
    let before = rng.uniform(15.0, 50.0);
    let bay = rng.uniform(45.0, 80.0);
    let mut layout = Layout::begin(
        start,
        &style,
        Course::straight(BEHIND + before + bay + 15.0),
    )?;
    layout.bay(rng.uniform(2.5, 3.0), BEHIND + before, bay)?;
    setting::extend(
        &mut layout,
        rng,
        &style,
        setting::needed_ahead(&style) - before - bay,
        0.3,
    )?;
    let mut setting = Setting::new(layout, BEHIND, rng.uniform(0.4, 0.9));
    if rng.bool(0.7) {
        setting.lane = LanePick::Rightmost;
    }
    Ok(setting)
}

fn populate(builder: &mut TrafficBuilder<'_, '_>) {
    let lanes = builder.roads().route_lanes[0].len();
    builder.fill_bay();
    if builder.rng.situation(|rng| rng.bool(0.55)) {
        let ahead = builder.rng.situation(|rng| rng.uniform(45.0, 95.0));
        // On a single lane the vehicle stands so far to the side that the ego can pass within the
        // lane.
        if lanes == 1 {
            let aside = builder.rng.uniform(1.7, 2.4);
            double_park(builder, ahead, aside);
        } else if builder.ego_lane + 1 == lanes {
            let aside = builder.rng.uniform(0.0, 0.4);
            double_park(builder, ahead, aside);
        }
    }
    builder.fill_lanes([0.2, 1.2], [105.0, 14.0]);
    builder.add_clutter();
    if builder.rng.situation(|rng| rng.bool(0.3)) {
        builder.add_jaywalker();
    }
}
