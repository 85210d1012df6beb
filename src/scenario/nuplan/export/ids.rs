//! Feature ids of lanes and roadblocks.

use planagent_world::LaneKind;
use std::collections::BTreeSet;

/// Ids for a list of lanes or roadblocks, by their kinds and ids in the source. The ids of the
/// source are kept where they are distinct and ascend within each kind: a kind has its own layer,
/// and readers sort by id. Otherwise ids count from 1.
pub(super) fn feature_ids(elements: impl Iterator<Item = (LaneKind, i64)>) -> Vec<i64> {
    let elements: Vec<(LaneKind, i64)> = elements.collect();
    let of = |wanted: LaneKind| {
        elements
            .iter()
            .filter(move |(kind, _)| *kind == wanted)
            .map(|&(_, id)| id)
    };
    let ascends = |kind: LaneKind| of(kind).zip(of(kind).skip(1)).all(|(id, next)| id < next);
    let different: BTreeSet<i64> = elements.iter().map(|&(_, id)| id).collect();
    let kept = ascends(LaneKind::Lane)
        && ascends(LaneKind::Connector)
        && different.len() == elements.len()
        && different.first().is_none_or(|&first| first >= 0);
    if kept {
        elements.into_iter().map(|(_, id)| id).collect()
    } else {
        (1..).take(elements.len()).collect()
    }
}

/// Hands out ids that are not in use.
#[derive(Debug, Clone)]
pub(super) struct FreeIds {
    next: i64,
}

impl FreeIds {
    /// The ids after the largest of a list.
    pub(super) fn after(used: &[i64]) -> Self {
        Self {
            next: used.iter().max().map_or(1, |&last| last.saturating_add(1)),
        }
    }

    pub(super) fn take(&mut self) -> i64 {
        let id = self.next;
        self.next += 1;
        id
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use LaneKind::{Connector, Lane};

    #[test]
    fn ids_of_the_source_are_kept_where_they_ascend_within_a_kind() {
        let ids = |elements: &[(LaneKind, i64)]| feature_ids(elements.iter().copied());
        assert_eq!(ids(&[(Lane, 0), (Connector, 1), (Lane, 5)]), [0, 1, 5]);
        assert_eq!(
            ids(&[(Lane, 3), (Lane, 5), (Connector, 1), (Connector, 4)]),
            [3, 5, 1, 4]
        );
        assert_eq!(ids(&[(Lane, 0), (Lane, 5), (Lane, 1)]), [1, 2, 3]);
        assert_eq!(ids(&[(Lane, 3), (Connector, 3)]), [1, 2]);
        assert_eq!(ids(&[(Lane, -1), (Lane, 3)]), [1, 2]);
        let mut free = FreeIds::after(&[0, 7, 5]);
        assert_eq!(
            (free.take(), free.take(), FreeIds::after(&[]).take()),
            (8, 9, 1)
        );
    }
}
