//! Feature ids of a layer.

/// Ids for a list of elements: those of the source when they ascend (readers go by id, and order can matter), else from 1 on.
pub(super) fn feature_ids(of_source: impl Iterator<Item = i64>) -> Vec<i64> {
    let ids: Vec<i64> = of_source.collect();
    let ascending = ids.first().is_none_or(|&first| first >= 0) && ids.windows(2).all(|pair| pair[0] < pair[1]);
    if ascending { ids } else { (1..).take(ids.len()).collect() }
}

/// Gives out the ids after those in use.
#[derive(Debug, Clone)]
pub(super) struct FreeIds {
    next: i64,
}

impl FreeIds {
    /// The ids after the largest of a list.
    pub(super) fn after(used: &[i64]) -> Self {
        Self { next: used.iter().max().map_or(1, |&last| last.saturating_add(1)) }
    }

    /// The next one.
    pub(super) fn take(&mut self) -> i64 {
        let id = self.next;
        self.next += 1;
        id
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_of_the_source_are_kept_where_they_ascend() {
        assert_eq!(feature_ids([0, 1, 5].into_iter()), [0, 1, 5]);
        assert_eq!(feature_ids([0, 5, 1].into_iter()), [1, 2, 3]);
        assert_eq!(feature_ids([3, 3].into_iter()), [1, 2]);
        assert_eq!(feature_ids([-1, 3].into_iter()), [1, 2]);
        let mut free = FreeIds::after(&[0, 7, 5]);
        assert_eq!((free.take(), free.take(), FreeIds::after(&[]).take()), (8, 9, 1));
    }
}
