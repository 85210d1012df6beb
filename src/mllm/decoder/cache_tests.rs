//! A layer's state is marked, branched and cut back like a list of rows.

use super::cache::{DecoderCache, LayerState};
use super::recurrence::{EVERY, Recurrence};
use candle_core::{Device, Tensor};
use proptest::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Rows of two numbers; the state mixes all rows so far, so that none can be taken out again.
#[derive(Debug, Default)]
struct Mixing {
    /// Rows that were run.
    run: AtomicUsize,
}

impl Recurrence for Mixing {
    fn state(&self) -> usize {
        3
    }

    fn row(&self) -> usize {
        2
    }

    fn out(&self) -> usize {
        1
    }

    fn run(&self, state: &mut [f32], rows: &[f32], out: &mut [f32]) {
        self.run.fetch_add(rows.len() / 2, Ordering::Relaxed);
        for (row, out) in rows.chunks_exact(2).zip(out) {
            state[2] = state[0] * 0.3 + state[2] * 0.9 + row[1];
            state[0] = (state[1] + row[0]).sin();
            state[1] = state[2] * 0.7 - row[0];
            *out = state[0] + 2.0 * state[1] + 3.0 * state[2];
        }
    }
}

fn cache(layers: usize) -> DecoderCache {
    let states = (0..layers).map(|_| LayerState::recurrent(Arc::new(Mixing::default())));
    DecoderCache::new(states.collect(), 4096)
}

fn rows(tokens: &[u16], layer: usize) -> Tensor {
    let numbers: Vec<f32> = tokens
        .iter()
        .flat_map(|token| {
            [
                f32::from(*token) / 9.0,
                layer as f32 - f32::from(*token) / 7.0,
            ]
        })
        .collect();
    Tensor::from_vec(numbers, (tokens.len(), 2), &Device::Cpu).unwrap()
}

/// The bits of what each layer gives for tokens that follow.
fn append(cache: &mut DecoderCache, layers: usize, tokens: &[u16]) -> Vec<u32> {
    let _ = cache.begin(tokens.len()).unwrap();
    let bits = (0..layers).flat_map(|layer| {
        let out = cache.run(layer, &rows(tokens, layer)).unwrap();
        out.flatten_all().unwrap().to_vec1::<f32>().unwrap()
    });
    let bits = bits.map(f32::to_bits).collect();
    cache.advance(tokens.len());
    bits
}

#[derive(Debug, Clone)]
enum Action {
    Append(Vec<u16>),
    Mark,
    Plan(usize),
    Cut(usize),
    Branch,
    Turn(usize),
    Fail(Vec<u16>),
}

fn actions() -> impl Strategy<Value = Vec<Action>> {
    let tokens = |most| prop::collection::vec(0_u16..50, 1..most);
    let action = prop_oneof![
        4 => tokens(6).prop_map(Action::Append),
        2 => tokens(70).prop_map(Action::Append),
        2 => Just(Action::Mark),
        2 => (0_usize..40).prop_map(Action::Plan),
        3 => (0_usize..200).prop_map(Action::Cut),
        1 => Just(Action::Branch),
        2 => (0_usize..4).prop_map(Action::Turn),
        1 => tokens(40).prop_map(Action::Fail),
    ];
    prop::collection::vec(action, 1..40)
}

/// A branch: its cache, its tokens, and its marks, which are kept.
type Branch = (DecoderCache, Vec<u16>);

const LAYERS: usize = 2;

/// The next tokens of a branch are those that the first layers have read when the last one fails.
fn fail(cache: &mut DecoderCache, tokens: &[u16]) {
    let unfinished = cache.begin(tokens.len()).unwrap();
    cache.run(0, &rows(tokens, 0)).unwrap();
    cache.undo(unfinished);
}

fn act(branches: &mut Vec<Branch>, at: &mut usize, action: &Action) {
    let count = branches.len();
    let (cache, known) = &mut branches[*at];
    match action {
        Action::Append(tokens) => {
            append(cache, LAYERS, tokens);
            known.extend(tokens);
            // The last positions of a pass are undone exactly, as a draft that was refused.
            let back = known.len() - tokens.len().min(EVERY);
            assert_eq!(cache.clone().cut(back), back);
        }
        Action::Mark => cache.mark_at(known.len()),
        Action::Plan(further) => cache.mark_at(known.len() + further),
        Action::Cut(len) => {
            let asked = (*len).min(known.len());
            let reached = cache.cut(asked);
            assert!(reached <= asked);
            known.truncate(reached);
        }
        Action::Branch if count < 4 => {
            let copy = branches[*at].clone();
            branches.push(copy);
        }
        Action::Branch => {}
        Action::Turn(to) => *at = to % count,
        Action::Fail(tokens) => fail(cache, tokens),
    }
}

proptest! {
    #[test]
    fn any_order_of_actions_leaves_what_a_fresh_run_gives(actions in actions()) {
        let (mut branches, mut at) = (vec![(cache(LAYERS), Vec::new())], 0);
        for action in &actions {
            act(&mut branches, &mut at, action);
            for (cache, known) in &branches {
                let mut fresh = self::cache(LAYERS);
                if !known.is_empty() {
                    append(&mut fresh, LAYERS, known);
                }
                prop_assert_eq!(cache.len(), known.len());
                let mut copy = cache.clone();
                let next = [7, 8, 9];
                prop_assert_eq!(append(&mut copy, LAYERS, &next), append(&mut fresh, LAYERS, &next));
            }
        }
    }

    #[test]
    fn a_cut_to_a_mark_is_exact_and_runs_nothing_again(
        before in 1_usize..90, mark in 1_usize..40, after in 1_usize..90,
    ) {
        let rule = Arc::new(Mixing::default());
        let mut cache = DecoderCache::new(vec![LayerState::recurrent(rule.clone())], 4096);
        let step = |cache: &mut DecoderCache, count: usize| {
            append(cache, 1, &vec![3; count])
        };
        step(&mut cache, before);
        cache.mark_at(before);
        cache.mark_at(before + mark);
        step(&mut cache, mark + after);
        let run = rule.run.load(Ordering::Relaxed);
        for mark in [before + mark, before] {
            prop_assert_eq!(cache.clone().cut(mark), mark);
        }
        // At most the rows of two points that are kept by themselves.
        prop_assert!(rule.run.load(Ordering::Relaxed) - run <= 2 * EVERY);
    }
}

#[test]
fn marks_beyond_the_most_are_forgotten_where_that_costs_the_least() {
    let mut cache = cache(1);
    for len in [100, 200, 203, 300, 400, 500, 600, 700, 800, 900] {
        let tokens = vec![1; len - cache.len()];
        append(&mut cache, 1, &tokens);
        cache.mark_at(len);
    }
    // 203 went first, then one of those that are 100 apart.
    let found = [899, 799, 299, 250, 150].map(|len| cache.clone().cut(len));
    assert_eq!(found, [899, 700, 200, 200, 0]);
}

#[test]
fn a_branch_shares_its_state_until_it_is_written() {
    let mut first = cache(1);
    append(&mut first, 1, &[1; 40]);
    let mut branch = first.clone();
    let own = append(&mut branch, 1, &[5, 6]);
    assert_eq!(append(&mut first.clone(), 1, &[5, 6]), own);
    assert_ne!(append(&mut first, 1, &[6, 5]), own);
}

#[test]
fn rows_that_do_not_follow_are_an_error() {
    let mut cache = cache(1);
    append(&mut cache, 1, &[1, 2]);
    let wide = Tensor::zeros((1, 3), candle_core::DType::F32, &Device::Cpu).unwrap();
    assert!(cache.run(0, &wide).is_err());
    assert!(cache.run(1, &rows(&[1], 0)).is_err());
    assert!(cache.begin(5000).is_err());
}
