//! What a layer keeps beyond keys and values: a state of one size, which each position changes.

use candle_core::Result;
use std::fmt::Debug;
use std::sync::Arc;

/// Positions from one point that is kept by itself to the next. The last positions of a pass, as many
/// as these, are undone exactly, whatever the marks are; no draft is longer.
pub(super) const EVERY: usize = 16;

/// How the state of a layer follows from the rows that it reads. It begins as zeros.
pub(crate) trait Recurrence: Debug + Send + Sync {
    /// Numbers of the state.
    fn state(&self) -> usize;

    /// Numbers of a row that it reads.
    fn row(&self) -> usize;

    /// Numbers of a row that it gives.
    fn out(&self) -> usize;

    /// Runs rows through the state, in order, and gives a row for each. The bits are the same
    /// however the rows are split.
    fn run(&self, state: &mut [f32], rows: &[f32], out: &mut [f32]);
}

/// The state of a layer, with earlier ones to go back to. An update cannot be undone, so a position
/// is reached from the last state before it that is kept, by the rows since then. Clones and kept
/// states share memory until one of them is written.
#[derive(Debug, Clone)]
pub(super) struct Recurrent {
    rule: Arc<dyn Recurrence>,
    now: Arc<Vec<f32>>,
    len: usize,
    /// States by their positions, ascending. That at 0 is no entry.
    saved_states: Vec<(usize, Arc<Vec<f32>>)>,
    /// The rows of the positions from `recent_start` on, whose state is kept.
    recent: Arc<Vec<f32>>,
    recent_start: usize,
}

impl Recurrent {
    pub(super) fn new(rule: Arc<dyn Recurrence>) -> Self {
        Self {
            now: Arc::new(vec![0.0; rule.state()]),
            rule,
            len: 0,
            saved_states: Vec::new(),
            recent: Arc::default(),
            recent_start: 0,
        }
    }

    /// Reads the rows of the positions from `start` on, and keeps the states at `stops`, which are
    /// ascending; those of `marks` stay.
    pub(super) fn run(
        &mut self,
        rows: &[f32],
        start: usize,
        stops: &[usize],
        marks: &[usize],
    ) -> Result<Vec<f32>> {
        let (row, width) = (self.rule.row(), self.rule.out());
        if start != self.len || row == 0 || !rows.len().is_multiple_of(row) {
            candle_core::bail!(
                "{} numbers are no rows of {row} from position {start} on, behind {}",
                rows.len(),
                self.len
            );
        }
        let tokens = rows.len() / row;
        let mut out = vec![0.0; tokens * width];
        // A state is kept where a run ends, so that the rows are run from stop to stop.
        let (mut rows, mut left) = (rows, out.as_mut_slice());
        let end = start + tokens;
        for stop in stops
            .iter()
            .copied()
            .filter(|stop| *stop <= end)
            .chain([end])
        {
            let count = stop.saturating_sub(self.len);
            let (now, later) = rows.split_at(count * row);
            let (written, rest) = std::mem::take(&mut left).split_at_mut(count * width);
            if count > 0 {
                let state: &mut Vec<f32> = Arc::make_mut(&mut self.now);
                self.rule.run(state, now, written);
                Arc::make_mut(&mut self.recent).extend_from_slice(now);
            }
            (rows, left) = (later, rest);
            self.len += count;
            if stops.contains(&stop) {
                self.keep(marks);
            }
        }
        Ok(out)
    }

    /// Keeps the state as it is now, and forgets those that nothing goes back to.
    pub(super) fn keep(&mut self, marks: &[usize]) {
        if self.len > 0
            && self
                .saved_states
                .last()
                .is_none_or(|(at, _)| *at < self.len)
        {
            self.saved_states.push((self.len, Arc::clone(&self.now)));
        }
        let far = |at: &usize| *at + 2 * EVERY <= self.len;
        let start = self.saved_states.iter().map(|(at, _)| *at).rfind(far);
        if let Some(start) = start.filter(|start| *start > self.recent_start) {
            let rows = (start - self.recent_start) * self.rule.row();
            Arc::make_mut(&mut self.recent).drain(..rows);
            self.recent_start = start;
        }
        let recent = self.recent_start;
        self.saved_states
            .retain(|(at, _)| *at >= recent || marks.contains(at));
    }

    /// The position nearest to `len`, and not behind it, that [`Self::cut`] goes back to: one of the
    /// last, or one of `marks`. It does not depend on positions that were computed and undone.
    pub(super) fn reach(&self, len: usize, marks: &[usize]) -> usize {
        let len = len.min(self.len);
        let last = (self.len / EVERY * EVERY).saturating_sub(EVERY);
        if len >= last.max(self.recent_start) {
            return len;
        }
        let mut before = self.saved_states.iter().map(|(at, _)| *at);
        before
            .rfind(|at| *at <= len && marks.contains(at))
            .unwrap_or(0)
    }

    /// Goes back to a position that [`Self::reach`] gave.
    pub(super) fn cut(&mut self, len: usize) {
        if len >= self.len {
            return;
        }
        self.saved_states.retain(|(at, _)| *at <= len);
        let (from, state) = match self.saved_states.last() {
            Some((at, state)) => (*at, Arc::clone(state)),
            None => (0, Arc::new(vec![0.0; self.rule.state()])),
        };
        (self.now, self.len) = (state, len);
        let row = self.rule.row();
        if len < self.recent_start {
            (self.recent, self.recent_start) = (Arc::default(), len);
            return;
        }
        let recent = Arc::make_mut(&mut self.recent);
        recent.truncate((len - self.recent_start) * row);
        let again = recent
            .get((from - self.recent_start) * row..)
            .expect("rows since the kept state are there");
        if !again.is_empty() {
            let mut out = vec![0.0; (len - from) * self.rule.out()];
            let state: &mut Vec<f32> = Arc::make_mut(&mut self.now);
            self.rule.run(state, again, &mut out);
        }
    }
}
