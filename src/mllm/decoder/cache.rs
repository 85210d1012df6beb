//! What the layers of a decoder keep of the positions before.

use super::recurrence::{EVERY, Recurrence, Recurrent};
use candle_core::{Result, Tensor};
use planagent_kernels::attention::{HeadShape, KeyValues, Precision, Projected};
use std::sync::Arc;

/// Most marks of a cache, each a copy of the states at most. Beyond them, the one is forgotten
/// whose loss costs the fewest positions.
const MAX_MARKS: usize = 8;

/// Most copies of a layer's state in a cache: that of the present, three that are kept by
/// themselves, and the marks.
pub(crate) const MAX_STATES: usize = MAX_MARKS + 4;
/// Most rows that a layer with a state keeps.
pub(crate) const MAX_ROWS: usize = 3 * EVERY;

/// What a layer keeps of the positions before.
#[derive(Debug, Clone)]
pub(crate) struct LayerState(Kind);

#[derive(Debug, Clone)]
enum Kind {
    KeyValues(KeyValues),
    Recurrent(Recurrent),
    /// Nothing: the layer reads what an earlier one keeps.
    Nothing,
}

impl LayerState {
    /// Keys and values of each position.
    pub(crate) fn key_values(shape: HeadShape, precision: Precision) -> Self {
        Self(Kind::KeyValues(KeyValues::new(shape, precision)))
    }

    /// Nothing, of a layer that reads the keys and values of an earlier one.
    pub(crate) fn nothing() -> Self {
        Self(Kind::Nothing)
    }

    /// A state that each position changes.
    pub(crate) fn recurrent(rule: Arc<dyn Recurrence>) -> Self {
        Self(Kind::Recurrent(Recurrent::new(rule)))
    }
}

/// What every layer of a decoder keeps of a sequence: keys and values, or a state that each
/// position changes.
///
/// Keys and values are cut back to any length. A layer's state is cut back to a mark
/// ([`Self::mark_at`]) or by a few positions, so that a cut may go further back than asked
/// ([`Self::cut`]). Clones and marks share memory until one of them writes: a branch costs one copy
/// of the states at most.
#[derive(Debug, Clone)]
pub struct DecoderCache {
    layers: Vec<LayerState>,
    len: usize,
    limit: usize,
    /// Positions whose states are kept, ascending.
    marks: Vec<usize>,
    /// Those to come.
    planned: Vec<usize>,
    /// Where states are kept in the pass that runs.
    stops: Vec<usize>,
}

impl DecoderCache {
    /// An empty cache of these layers for at most `limit` positions.
    pub(crate) fn new(layers: Vec<LayerState>, limit: usize) -> Self {
        Self {
            layers,
            len: 0,
            limit,
            marks: Vec::new(),
            planned: Vec::new(),
            stops: Vec::new(),
        }
    }

    /// Number of positions.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Marks the position `len`, where the cache is or will be. Cuts to it are exact, until so many
    /// later marks follow that it is forgotten.
    pub(crate) fn mark_at(&mut self, len: usize) {
        if len > self.len {
            if !self.planned.contains(&len) {
                self.planned.push(len);
            }
        } else if len == self.len && len > 0 {
            self.note_mark(len);
            self.each_recurrent(Recurrent::keep);
        }
    }

    /// Forgets the marks that are not reached yet.
    pub(crate) fn drop_planned_marks(&mut self) {
        self.planned.clear();
    }

    /// Cuts back to the nearest position before or at `len` that every layer goes back to, and
    /// gives that.
    pub(crate) fn cut(&mut self, len: usize) -> usize {
        let mut reached = self.len.min(len);
        // Until all agree: where one goes back to, another may not.
        loop {
            let before = reached;
            for layer in &self.layers {
                if let Kind::Recurrent(state) = &layer.0 {
                    reached = state.reach(reached, &self.marks);
                }
            }
            if reached == before {
                break;
            }
        }
        self.each_recurrent(|state, _| state.cut(reached));
        self.marks.retain(|mark| *mark <= reached);
        self.len = reached;
        reached
    }

    /// Begins a pass over so many positions. What is given undoes it.
    pub(super) fn begin(&mut self, tokens: usize) -> Result<Unfinished> {
        self.check_room(tokens)?;
        let (start, end) = (self.len, self.len + tokens);
        let recurrent = self.layers.iter().filter(|layer| layer.is_recurrent());
        let earlier = recurrent.cloned().collect::<Vec<_>>();
        if earlier.is_empty() {
            return Ok(Unfinished(Vec::new()));
        }
        let passed = |mark: &usize| start < *mark && *mark <= end;
        let planned: Vec<usize> = self.planned.iter().copied().filter(passed).collect();
        self.planned.retain(|mark| *mark > end);
        // The last three are all that stays.
        let last = end / EVERY * EVERY;
        let own = [2, 1, 0].map(|before| last.saturating_sub(before * EVERY));
        self.stops = planned
            .iter()
            .copied()
            .chain(own.into_iter().filter(passed))
            .collect();
        self.stops.sort_unstable();
        self.stops.dedup();
        for mark in planned {
            self.note_mark(mark);
        }
        // A few positions are undone by a cut, without another copy.
        let kept = if tokens > EVERY { earlier } else { Vec::new() };
        Ok(Unfinished(kept))
    }

    /// Undoes the pass that failed.
    pub(super) fn undo(&mut self, unfinished: Unfinished) {
        let Unfinished(earlier) = unfinished;
        let len = self.len;
        if earlier.is_empty() {
            self.each_recurrent(|state, _| state.cut(len));
        } else {
            let recurrent = self.layers.iter_mut().filter(|layer| layer.is_recurrent());
            recurrent
                .zip(earlier)
                .for_each(|(layer, earlier)| *layer = earlier);
        }
        self.marks.retain(|mark| *mark <= len);
    }

    fn check_room(&self, tokens: usize) -> Result<()> {
        let needed = self.len + tokens;
        if needed > self.limit {
            candle_core::bail!(
                "{needed} positions do not fit into a context of {}",
                self.limit
            );
        }
        Ok(())
    }

    /// Writes the keys and values of rows of a layer after the last position and returns all of
    /// that layer. When every layer has written, [`Self::advance`] counts the new positions.
    pub(crate) fn write(&mut self, layer: usize, rows: &Projected<'_>) -> Result<&KeyValues> {
        self.check_room(rows.tokens())?;
        let Some(LayerState(Kind::KeyValues(held))) = self.layers.get_mut(layer) else {
            candle_core::bail!("the cache has no keys of layer {layer}");
        };
        held.write(rows, self.len)?;
        Ok(held)
    }

    /// The keys and values of a layer, with those that it has written in the pass that runs.
    pub(crate) fn keys(&self, layer: usize) -> Result<&KeyValues> {
        match self.layers.get(layer) {
            Some(LayerState(Kind::KeyValues(held))) => Ok(held),
            _ => candle_core::bail!("the cache has no keys of layer {layer}"),
        }
    }

    /// Runs rows (positions, numbers) that follow the last position through the state of a layer.
    pub(crate) fn run(&mut self, layer: usize, rows: &Tensor) -> Result<Tensor> {
        let (tokens, _) = rows.dims2()?;
        let numbers = rows.flatten_all()?.to_vec1::<f32>()?;
        let Some(LayerState(Kind::Recurrent(state))) = self.layers.get_mut(layer) else {
            candle_core::bail!("the cache has no state of layer {layer}");
        };
        let out = state.run(&numbers, self.len, &self.stops, &self.marks)?;
        let width = out.len() / tokens.max(1);
        Tensor::from_vec(out, (tokens, width), rows.device())
    }

    /// Counts `tokens` positions that every layer has written.
    pub(crate) fn advance(&mut self, tokens: usize) {
        self.len = (self.len + tokens).min(self.limit);
    }

    /// Adds a mark, and forgets one where they are too many.
    fn note_mark(&mut self, mark: usize) {
        if self.marks.contains(&mark) {
            return;
        }
        self.marks.push(mark);
        self.marks.sort_unstable();
        if self.marks.len() > MAX_MARKS {
            // What a cut to each would cost without it; the last stays.
            let before = std::iter::once(0).chain(self.marks.iter().copied());
            let gaps = self
                .marks
                .iter()
                .zip(before)
                .map(|(at, before)| at - before);
            let cheapest = gaps.take(MAX_MARKS).enumerate().min_by_key(|(_, gap)| *gap);
            if let Some((index, _)) = cheapest {
                self.marks.remove(index);
            }
        }
    }

    fn each_recurrent(&mut self, change: impl Fn(&mut Recurrent, &[usize])) {
        for layer in &mut self.layers {
            if let Kind::Recurrent(state) = &mut layer.0 {
                change(state, &self.marks);
            }
        }
    }
}

impl LayerState {
    fn is_recurrent(&self) -> bool {
        matches!(self.0, Kind::Recurrent(_))
    }
}

/// A pass that has begun: the states before it, where a cut does not reach them.
#[derive(Debug)]
pub(super) struct Unfinished(Vec<LayerState>);
