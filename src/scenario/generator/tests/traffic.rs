//! The same seed among other traffic.

use super::super::{ScenarioType, Spec, generate, generate_with_record};
use super::CORPUS;
use super::names::same_map;
use crate::scenario::Scenario;
use rayon::prelude::*;

#[test]
fn other_traffic_keeps_roads_route_and_situation() {
    let seeds = || ScenarioType::ALL.into_iter().flat_map(|kind| (3..6).map(move |seed| Spec::new(kind, seed)));
    let check = |spec: Spec| {
        let [own, first, second] = [0, 1, 2].map(|traffic| generate(&spec.with_traffic_seed(traffic)).unwrap());
        for (a, b) in [(&own, &first), (&own, &second), (&first, &second)] {
            assert!(same_map(&a.map, &b.map) && a.route.roadblocks == b.route.roadblocks, "{} {}", a.id, b.id);
            let objects =
                |scenario: &Scenario| -> Vec<_> { scenario.frames.iter().map(|f| f.objects.clone()).collect() };
            assert!(objects(a) != objects(b), "{} {}", a.id, b.id);
            assert_eq!((&a.scenario_type, &a.log_name), (&b.scenario_type, &b.log_name));
            let lanes = |scenario: &Scenario| scenario.frames[0].lights.iter().count();
            assert_eq!(lanes(a), lanes(b), "{} {}", a.id, b.id);
        }
        assert_eq!((own.id.as_str(), first.id), (spec.to_string().as_str(), format!("{spec}.1")));
    };
    seeds().collect::<Vec<_>>().into_par_iter().for_each(check);
}

/// Draws that are thrown away among other traffic are drawn anew among it: those of the seed's own come first.
#[test]
fn draws_are_thrown_away_by_traffic() {
    let own = &CORPUS[0];
    let spec: Spec = own.scenario.id.parse().unwrap();
    let other = generate_with_record(&spec.with_traffic_seed(3)).unwrap();
    assert!(other.discarded.starts_with(&own.discarded));
    assert_eq!(other.scenario.frames, generate(&spec.with_traffic_seed(3)).unwrap().frames);
}
