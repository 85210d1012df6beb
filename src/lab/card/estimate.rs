//! How long a card takes, told before most of the work.

use planagent_runs::runner::{Event, Listener};
use std::time::Duration;

/// Questions at a state with changes: those of most scenes.
const QUESTIONS_AT_STATE: f64 = 9.0;
/// Planning calls of a simulation, and attempts of a call.
const CALLS: f64 = 12.0;
const ATTEMPTS: f64 = 1.4;
/// Time of a simulation without its model, and of the search in a pair of text twins.
const SIMULATION: Duration = Duration::from_millis(700);
const PAIR: Duration = Duration::from_millis(500);
/// Simulations of a source for each scene of the limit: two challenges of one suite, one of the
/// other.
const PER_SCENE: usize = 3;
/// Sources without a model.
const CONTROLS: usize = 4;

/// The work of a card.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimate {
    pub(super) states: usize,
    pub(super) pairs: usize,
    pub(super) scenes: usize,
    pub(super) sees: bool,
}

impl Estimate {
    /// Tells what is to be done, and how long that takes if a state takes this time on one thread.
    pub(super) fn tell(self, per_state: Duration, listener: &Listener) {
        let threads = rayon::current_num_threads();
        let minutes = self.time(per_state, threads).as_secs_f64() / 60.0;
        listener(Event::Note(format!(
            "about {minutes:.1} minutes on {threads} threads, if nothing was done before: {} states, {} pairs of text twins, \
             {} simulations; --limit makes it shorter",
            self.states,
            self.pairs,
            self.of_model() + self.of_controls()
        )));
    }

    fn time(self, per_state: Duration, threads: usize) -> Duration {
        let question = per_state.div_f64(QUESTIONS_AT_STATE);
        let of_model = SIMULATION + question.mul_f64(CALLS * ATTEMPTS);
        let work = per_state.mul_f64(self.states as f64)
            + (PAIR + question.mul_f64(2.0)).mul_f64(self.pairs as f64)
            + of_model.mul_f64(self.of_model() as f64)
            + SIMULATION.mul_f64(self.of_controls() as f64);
        work.div_f64(threads.max(1) as f64)
    }

    /// Simulations with the model: as it is, late, and with other pictures.
    fn of_model(self) -> usize {
        let sources = if self.sees { 4 } else { 2 };
        PER_SCENE
            .saturating_mul(self.scenes)
            .saturating_mul(sources)
    }

    fn of_controls(self) -> usize {
        PER_SCENE
            .saturating_mul(self.scenes)
            .saturating_mul(CONTROLS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_model_takes_longer_and_more_threads_less() {
        let card = Estimate {
            states: 8,
            pairs: 2,
            scenes: 2,
            sees: true,
        };
        let time = |seconds, threads| card.time(Duration::from_secs(seconds), threads);
        assert_eq!(card.of_model() + card.of_controls(), 48);
        assert!(time(1, 2) < time(1, 1) && time(1, 1) < time(9, 1));
    }
}
