//! The benchmark loop: one model after the other, engines in alternation.

use super::agreement::{Agreement, PictureAgreement};
use super::budget::{CallBudget, DRAFTED};
use super::engine::{Engine, EngineError, EngineName};
use super::machine_limits::keep_middle;
use super::protocol::{Like, LoadRequest, Loaded, ModelChoice};
use super::python::PythonWorker;
use super::row::{FailedRow, IterationRow, ModelRow, Row, TimedStep};
use super::workload::{DEPTHS, Workload};
use planagent_mllm::{PromptSet, WeightFormat};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::process::Command;

/// A model to measure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// The name in results.
    pub name: String,
    /// The name of the model, for files of its weights.
    pub weights: String,
    pub model: ModelChoice,
    /// The prompt set that determines the token counts of its calls.
    pub prompts: PromptSet,
    /// Side of its image, pixels; none for that of the model.
    pub image_size: Option<u32>,
}

#[derive(Debug)]
pub struct BenchSettings {
    /// Iterations of each workload before the measured ones.
    pub warm_up: usize,
    /// Measured iterations of each workload.
    pub iterations: usize,
    pub threads: usize,
    /// Seed of random weights and of the prompt tokens.
    pub seed: u64,
    /// Weight format of the matrices; `None` for that of the files.
    pub weight_format: Option<WeightFormat>,
    /// Whether this program also measures calls with drafts, of which a quarter, half and three
    /// quarters are accepted.
    pub speculation: bool,
    /// The engine to compare with.
    pub versus: Option<Other>,
}

/// Another engine on the same files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Other {
    /// It requires that all models are files that the engine reads.
    Python(PythonWorker),
    /// candle-transformers' own decoders, in a process of this program that runs
    /// [`serve_candle`](super::serve_candle).
    Candle,
}

impl Other {
    fn start(&self, program: &dyn Fn() -> Command) -> Result<Engine, EngineError> {
        match self {
            Self::Python(worker) => worker.start(),
            Self::Candle => Engine::start(EngineName::Candle, program().arg(CANDLE)),
        }
    }
}

/// The option of the measuring process that makes it compute with candle's decoders.
const CANDLE: &str = "--candle";
/// Lengths of the prompts that two engines answer, tokens.
const PROMPTS: [usize; 4] = [1, 16, 64, 200];
/// Tokens of a picture that are compared, at most.
const PICTURE: usize = 64;
/// Tokens of an answer that are compared.
const ANSWER: usize = 16;

/// Share of the best limit of a run below which the processor was disturbed or throttled.
const STEADY: f64 = 0.9;
/// Times that a disturbed model is measured again.
const REPEATS: usize = 2;

#[derive(Debug, Clone, Copy)]
pub enum Progress<'a> {
    Loading(EngineName, &'a Candidate),
    /// A depth is not measured, with the reason.
    LeftOut(&'a Candidate, &'a EngineError),
    /// A model is measured again, because the processor reached this share of its best.
    Disturbed(&'a Candidate, f64),
    /// An iteration is done; the number is the total of iterations.
    Done(&'a IterationRow, usize),
}

/// Measures models. `program` starts a process of this program that runs [`serve`](super::serve()).
/// `commit` gets all rows of a model at once. A model is measured again, twice at most, if the
/// processor's limit fell to nine tenths of the best of this run. A model that fails gives a [`Row::Failed`], and the
/// next model follows.
///
/// # Errors
/// The error of `commit`.
pub fn run<E>(
    candidates: &[Candidate],
    settings: &BenchSettings,
    program: &dyn Fn() -> Command,
    commit: &mut dyn FnMut(&[Row]) -> Result<(), E>,
    progress: &dyn Fn(Progress<'_>),
) -> Result<(), E> {
    let (mut best, mut measured) = (0.0, Vec::new());
    // One after the other: models that share the processor would measure each other.
    for candidate in candidates {
        let bench = Bench {
            candidate,
            settings,
            program,
            progress,
        };
        let rows = bench
            .measure_undisturbed(&mut best)
            .unwrap_or_else(|error| {
                vec![Row::Failed(FailedRow {
                    model: candidate.name.clone(),
                    problem: error.to_string(),
                })]
            });
        let of_own = rows.iter().filter_map(|row| match row {
            Row::Model(row) => Some(row.limits.iter().cloned()),
            _ => None,
        });
        measured.extend(of_own.flatten());
        commit(&rows)?;
    }
    keep_middle(&measured);
    Ok(())
}

struct Bench<'a> {
    candidate: &'a Candidate,
    settings: &'a BenchSettings,
    program: &'a dyn Fn() -> Command,
    progress: &'a dyn Fn(Progress<'_>),
}

/// An engine with a loaded model.
struct Ready {
    engine: Engine,
    loaded: Loaded,
}

impl Bench<'_> {
    /// Measures until the processor is as fast as at its best, operations a second.
    fn measure_undisturbed(&self, best: &mut f64) -> Result<Vec<Row>, EngineError> {
        let mut rows = self.measure()?;
        for _ in 0..REPEATS {
            let limits = rows.iter().filter_map(|row| match row {
                Row::Model(row) => Some(row.limits.iter()),
                _ => None,
            });
            let operations: Vec<f64> = limits.flatten().map(|all| all.operations_per_s).collect();
            *best = operations.iter().copied().fold(*best, f64::max);
            let lowest = operations.into_iter().fold(f64::INFINITY, f64::min);
            if lowest >= STEADY * *best {
                break;
            }
            (self.progress)(Progress::Disturbed(self.candidate, lowest / *best));
            rows = self.measure()?;
        }
        Ok(rows)
    }

    /// Measures the engines in turns: their steps alternate, each in a process of its own.
    /// Why: docs/decisions/006-bench-processes.md.
    fn measure(&self) -> Result<Vec<Row>, EngineError> {
        let mut workloads = vec![Workload::Call(CallBudget::for_prompts(
            self.candidate.prompts,
        ))];
        let mut engines = Vec::new();
        match &self.settings.versus {
            None => engines.push(self.load(self.own()?, None)?),
            Some(other) => {
                workloads.splice(0..0, DEPTHS.map(Workload::Depth));
                let ours = self.load(self.own()?, None)?;
                let theirs = other.start(self.program)?;
                let Loaded {
                    context,
                    image_side,
                    image_tokens,
                    ..
                } = ours.loaded;
                let longest = workloads.iter().map(|load| load.longest(image_tokens));
                let mut theirs = self.load(
                    theirs,
                    Some(Like {
                        // llama.cpp takes the memory of the whole context at once.
                        context: context.min(longest.max().unwrap_or(context)),
                        image_side,
                        image_tokens,
                    }),
                )?;
                // The others report these for the decoder only, or not; the weights are the same.
                theirs.loaded.parameters = ours.loaded.parameters;
                if theirs.engine.name() == EngineName::LlamaCpp {
                    let format = ours.loaded.weight_format.clone();
                    theirs.loaded.weight_format = format;
                }
                engines.extend([ours, theirs]);
            }
        }
        let own = engines.first_mut().expect("the own engine comes first");
        let mut limits = vec![own.engine.limits()?];
        let mut rows = Vec::new();
        if self.settings.versus.is_some() {
            rows.push(Row::Agreement(self.agreement(&mut engines)?));
        }
        for workload in &workloads {
            match (Self::misfit(workload, &engines), workload) {
                (None, _) => {}
                (Some(misfit), Workload::Call(_)) => return Err(misfit),
                (Some(misfit), Workload::Depth(_)) => {
                    (self.progress)(Progress::LeftOut(self.candidate, &misfit));
                    continue;
                }
            }
            rows.extend(
                self.alternate(workload, &mut engines)?
                    .into_iter()
                    .map(Row::Iteration),
            );
        }
        for accepted in if self.settings.speculation {
            1..DRAFTED
        } else {
            0..0
        } {
            let workload = Workload::Call(
                CallBudget::for_prompts(self.candidate.prompts).with_drafts(accepted),
            );
            let own = engines.get_mut(..1).expect("the own engine comes first");
            rows.extend(
                self.alternate(&workload, own)?
                    .into_iter()
                    .map(Row::Iteration),
            );
        }
        let own = engines.first_mut().expect("the own engine comes first");
        limits.push(own.engine.limits()?);
        let prompt_tokens = CallBudget::for_prompts(self.candidate.prompts).prompt_tokens();
        rows.extend(engines.into_iter().map(|Ready { engine, loaded }| {
            let peak_memory = engine.peak_memory();
            let (model, engine) = (self.candidate.name.clone(), engine.name());
            Row::Model(ModelRow {
                model,
                engine,
                loaded,
                prompt_tokens,
                peak_memory,
                limits: std::mem::take(&mut limits),
            })
        }));
        Ok(rows)
    }

    /// Compares the answers of two engines to prompts of random tokens, and what they make of a
    /// picture.
    fn agreement(&self, engines: &mut [Ready]) -> Result<Agreement, EngineError> {
        let [ours, theirs] = engines else {
            let problem = "there is no other engine".to_owned();
            return Err(EngineError::Failed {
                engine: EngineName::PlanAgent,
                problem,
            });
        };
        let vocabulary = ours.loaded.vocabulary.min(theirs.loaded.vocabulary).max(1) as u32;
        let context = ours.loaded.context.min(theirs.loaded.context);
        let mut words = Pcg64Mcg::seed_from_u64(self.settings.seed);
        let mut pairs = Vec::new();
        for length in PROMPTS {
            if length + ANSWER > context {
                continue;
            }
            // Neither engine reads the image's token without an image.
            let drawn = std::iter::repeat_with(|| words.random_range(0..vocabulary));
            let image = ours.loaded.image_token;
            let text = drawn.filter(|word| Some(*word) != image || vocabulary == 1);
            let prompt: Vec<u32> = text.take(length).collect();
            let own = ours.engine.answer(prompt.clone(), ANSWER)?;
            pairs.push((own, theirs.engine.answer(prompt, ANSWER)?));
        }
        let engine = theirs.engine.name();
        let mut found = Agreement::between(&self.candidate.name, engine, &pairs)
            .map_err(|problem| EngineError::Failed { engine, problem })?;
        let side = ours.loaded.image_side;
        if side > 0 && theirs.loaded.image_tokens > 0 {
            let own = ours.engine.features(side, PICTURE)?;
            let other = theirs.engine.features(side, PICTURE)?;
            found.picture = Some(PictureAgreement::between(&own, &other));
        }
        Ok(found)
    }

    fn own(&self) -> Result<Engine, EngineError> {
        Engine::start(EngineName::PlanAgent, &mut (self.program)())
    }

    fn load(&self, mut engine: Engine, like: Option<Like>) -> Result<Ready, EngineError> {
        (self.progress)(Progress::Loading(engine.name(), self.candidate));
        let BenchSettings {
            weight_format,
            threads,
            seed,
            ..
        } = *self.settings;
        let model = self.candidate.model.clone();
        let loaded = engine.load(LoadRequest {
            model,
            weight_format,
            threads,
            image_size: self.candidate.image_size,
            like,
            seed,
        })?;
        Ok(Ready { engine, loaded })
    }

    /// Why these engines cannot run a workload, if so.
    fn misfit(workload: &Workload, engines: &[Ready]) -> Option<EngineError> {
        engines.iter().find_map(|Ready { engine, loaded }| {
            let needed = workload.longest(loaded.image_tokens);
            let problem = format!(
                "{} takes {needed} tokens, and the context has {}",
                workload.name(),
                loaded.context
            );
            (needed > loaded.context).then(|| EngineError::Failed {
                engine: engine.name(),
                problem,
            })
        })
    }

    /// Runs the iterations of a workload; in each, one engine follows the other.
    fn alternate(
        &self,
        workload: &Workload,
        engines: &mut [Ready],
    ) -> Result<Vec<IterationRow>, EngineError> {
        for Ready { engine, loaded } in engines.iter_mut() {
            engine.run(workload.first_steps(loaded.layout))?;
        }
        let BenchSettings {
            warm_up,
            iterations,
            ..
        } = *self.settings;
        let mut rows = Vec::new();
        // In turns, so that a machine that slows down slows all engines.
        for iteration in 0..warm_up + iterations {
            for Ready { engine, loaded } in engines.iter_mut() {
                let steps = workload.steps(loaded.layout, loaded.image_tokens);
                let times = engine.run(steps.clone())?;
                let row = IterationRow {
                    model: self.candidate.name.clone(),
                    engine: engine.name(),
                    workload: workload.name(),
                    iteration,
                    warm_up: iteration < warm_up,
                    steps: steps
                        .into_iter()
                        .zip(times)
                        .map(|(step, time)| TimedStep { step, time })
                        .collect(),
                };
                (self.progress)(Progress::Done(&row, warm_up + iterations));
                rows.push(row);
            }
        }
        Ok(rows)
    }
}
