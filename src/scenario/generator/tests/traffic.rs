//! The same seed with other traffic.

use super::super::{Spec, generate, generate_with_record, types};
use super::CORPUS;
use super::names::same_map;
use crate::Scenario;
use rayon::prelude::*;

#[test]
fn other_traffic_keeps_roads_route_and_situation() {
    let seeds =
        || types::in_suites().flat_map(|kind| (3..6).map(move |seed| Spec::new(kind, seed)));
    let check = |spec: Spec| {
        let [own, first, second] =
            [0, 1, 2].map(|traffic| generate(&spec.with_traffic_seed(traffic)).unwrap());
        for (a, b) in [(&own, &first), (&own, &second), (&first, &second)] {
            assert!(
                same_map(&a.map, &b.map) && a.route.roadblocks == b.route.roadblocks,
                "{} {}",
                a.id,
                b.id
            );
            let objects = |scenario: &Scenario| -> Vec<_> {
                scenario.frames.iter().map(|f| f.objects.clone()).collect()
            };
            assert!(objects(a) != objects(b), "{} {}", a.id, b.id);
            assert_eq!(
                (&a.scenario_type, &a.log_name),
                (&b.scenario_type, &b.log_name)
            );
            let lanes = |scenario: &Scenario| scenario.frames[0].lights.iter().count();
            assert_eq!(lanes(a), lanes(b), "{} {}", a.id, b.id);
        }
        assert_eq!(
            (own.id.as_str(), first.id),
            (spec.to_string().as_str(), format!("{spec}.1"))
        );
    };
    seeds().collect::<Vec<_>>().into_par_iter().for_each(check);
}

/// The discarded draws of the seed come first, then those with the traffic seed.
#[test]
fn discarded_draws_are_kept_in_order() {
    let own = &CORPUS[0];
    let spec: Spec = own.scenario.id.parse().unwrap();
    let other = generate_with_record(&spec.with_traffic_seed(3)).unwrap();
    assert!(other.discarded.starts_with(&own.discarded));
    assert_eq!(
        other.scenario.frames,
        generate(&spec.with_traffic_seed(3)).unwrap().frames
    );
}
