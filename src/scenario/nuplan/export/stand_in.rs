//! Empty maps under the names of nuPlan's locations.

/// The locations that the devkit loads whenever it opens a maps folder (devkit `gpkg_mapsdb.py`,
/// `MAP_LOCATIONS`).
pub(crate) const OFFICIAL_LOCATIONS: [&str; 4] = [
    "sg-one-north",
    "us-ma-boston",
    "us-nv-las-vegas-strip",
    "us-pa-pittsburgh-hazelwood",
];
/// The row of layer `meta` that marks an empty map,
pub(super) const STAND_IN_KEY: &str = "standIn";
/// and its value.
pub(super) const STAND_IN_NOTE: &str = "empty; written by PlanAgent in place of nuPlan's map";
