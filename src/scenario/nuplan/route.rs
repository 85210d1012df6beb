//! The route of a scene: ids of roadblocks and roadblock connectors in a text.

use super::map_store::NuPlanMap;
use crate::world::RoadblockId;

/// Why the route of a scene cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RouteFault {
    /// No roadblock at all.
    #[error("its route is empty (column roadblock_ids)")]
    Empty,
    /// Not an id.
    #[error("its route holds `{word}` in column roadblock_ids, expected ids separated by spaces")]
    Word {
        /// What stands there.
        word: String,
    },
    /// The map does not know it.
    #[error("its route holds roadblock {id}, which the map {map} does not have; do log and map belong together?")]
    Unknown {
        /// The id.
        id: i64,
        /// Name of the map.
        map: String,
    },
}

/// The ids of a route's text, as the devkit splits it: at single spaces.
pub(super) fn ids(text: Option<&str>) -> Result<Vec<i64>, RouteFault> {
    let words: Vec<&str> = text.unwrap_or_default().split(' ').filter(|word| !word.is_empty()).collect();
    if words.is_empty() {
        return Err(RouteFault::Empty);
    }
    words.into_iter().map(|word| word.parse().map_err(|_| RouteFault::Word { word: word.to_owned() })).collect()
}

/// The roadblocks of a route: of each id the roadblock, else the roadblock connector.
pub(super) fn roadblocks(ids: &[i64], map: &NuPlanMap) -> Result<Vec<RoadblockId>, RouteFault> {
    let unknown = |id: i64| RouteFault::Unknown { id, map: map.lanes.name().to_owned() };
    ids.iter().map(|&id| map.roadblock(id).ok_or_else(|| unknown(id))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_separated_by_spaces() {
        assert_eq!(ids(Some("12 34  5 ")), Ok(vec![12, 34, 5]));
        assert_eq!(ids(Some("")), Err(RouteFault::Empty));
        assert_eq!(ids(None), Err(RouteFault::Empty));
        assert_eq!(ids(Some("12,34")), Err(RouteFault::Word { word: "12,34".to_owned() }));
    }
}
