//! LLM-ASSIST (Sharan et al. 2024): PDM-Closed is executed until none of its proposals scores
//! enough. Then a language model is asked for a plan (UNC) or for other parameters of PDM-Closed
//! (PAR).
//!
//! The paper says this much, and that the model may be asked several times. The rest is our
//! reading: prompts and answers are those of [`crate::reasoning`]. An answer is executed for as
//! long as PlanAgent's plans. Answers are scored as PDM-Closed's proposals are. One that reaches τ
//! is taken at once. After the last attempt the best answer is taken if it scores more than
//! PDM-Closed's own best proposal; else PDM-Closed is executed. The emergency brake does not
//! overrule a plan.

mod drive;
mod handed;
mod waypoints;

#[doc(hidden)]
pub use drive::AssistDrive;
#[doc(hidden)]
pub use handed::HandedAnswers;

use super::attempts::{AttemptLimits, Attempts, Question, Trial};
use super::clock::Clock;
use super::language_agent::{CallTerms, LanguageAgent, Shown, planning_call};
use super::record::{Decision, NoPlan, PlanningCall};
use super::{
    PlanAgentSettings, Planner, PlannerError, PlannerInitialization, PlannerInput, PlannerName,
};
use crate::environment::coordinates::llm_assist_text;
use crate::environment::text::{self, Description};
use crate::environment::{GraphedScene, TextForm};
use crate::reasoning::{
    AssistParameters, AssistQuestion, AssistReasoning, AssistVariant, Assistance, Feedback, Names,
    PromptSet, ReasoningError, ReasoningSettings, ReasoningTrace, WAYPOINT_SECONDS,
};
use crate::reflection::Judge;
use planagent_mllm::{Mllm, milliseconds};
use planagent_score::pdm::{
    Collided, PROPOSAL_STEPS, PdmMemory, PdmParameters, ReferencePath, plan_tuned,
};
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, STEP_S, SceneView, Trajectory, TrajectoryError};
use std::sync::Arc;
use std::time::Instant;

/// LLM-ASSIST in one of its variants.
pub struct LlmAssist {
    name: PlannerName,
    source: AnswerSource,
    settings: PlanAgentSettings,
    drive: AssistDrive,
    /// The score of PDM-Closed's best proposal when the model was last to be asked.
    score: f64,
    /// When the active answer ends and the model may be asked again.
    clock: Clock,
    calls: Vec<PlanningCall>,
}

/// Where the answers come from.
enum AnswerSource {
    /// A model that is asked in a variant's form.
    Model(AssistVariant, AskedModel),
    /// What stands in a model's place.
    Handed(HandedAnswers),
}

/// The model that is asked, and how.
pub struct AskedModel {
    /// The model.
    pub model: Arc<dyn Mllm>,
    /// The prompts that it is asked with.
    pub prompts: Arc<PromptSet>,
    /// How it is asked.
    pub reasoning: ReasoningSettings,
}

/// What an answer stands for.
#[derive(Debug, Clone)]
pub enum Assisted {
    /// A trajectory.
    Plan(Trajectory),
    /// PDM-Closed with these parameters.
    Parameters(PdmParameters),
}

impl Assisted {
    /// What an answer stands for at the present state of the ego.
    fn from_answer(assistance: &Assistance, ego: &EgoState) -> Result<Self, TrajectoryError> {
        Ok(match assistance {
            Assistance::Waypoints(list) => Self::Plan(waypoints::through(ego, list)?),
            Assistance::Parameters(parameters) => Self::Parameters(tuned(*parameters)),
        })
    }
}

impl LlmAssist {
    /// A planner that asks this model. τ is the gate of the settings, else their λ. A planning call
    /// lasts no simulated time.
    pub fn new(
        name: PlannerName,
        variant: AssistVariant,
        asked: AskedModel,
        settings: PlanAgentSettings,
    ) -> Self {
        Self::answered_by(name, AnswerSource::Model(variant, asked), settings)
    }

    /// The same with answers that are handed over before a planning call, the first attempt's first.
    #[doc(hidden)]
    pub fn handed(name: PlannerName, answers: HandedAnswers, settings: PlanAgentSettings) -> Self {
        Self::answered_by(name, AnswerSource::Handed(answers), settings)
    }

    fn answered_by(name: PlannerName, source: AnswerSource, settings: PlanAgentSettings) -> Self {
        Self {
            name,
            source,
            settings,
            drive: AssistDrive::default(),
            score: 0.0,
            clock: Clock::default(),
            calls: Vec::new(),
        }
    }

    /// What drives, for what stands in the model's place.
    #[doc(hidden)]
    pub fn drive(&self) -> &AssistDrive {
        &self.drive
    }

    /// Time for which an answer is executed, seconds.
    #[doc(hidden)]
    pub fn answer_s(&self) -> f64 {
        self.settings.agent.interval_s.min(WAYPOINT_SECONDS as f64)
    }

    /// Whether the next step, in this scene, begins with a planning call.
    #[doc(hidden)]
    pub fn begins_with_call(&self, scene: &SceneView<'_>) -> bool {
        let mut clock = self.clock.clone();
        clock.step(scene.ego.time_us);
        let scores_little = || {
            let rules = self.drive.clone().rules(scene);
            rules.is_ok_and(|rules| rules.scores[rules.best].total < self.tau())
        };
        clock.is_due(self.answer_s()) && scores_little()
    }

    /// τ.
    fn tau(&self) -> f64 {
        self.settings
            .agent
            .gate
            .unwrap_or(self.settings.reflection.threshold)
    }
}

impl LanguageAgent for LlmAssist {
    type Observation<'a> = AssistQuestion;
    type Plan = Assisted;

    fn settings(&self) -> &PlanAgentSettings {
        &self.settings
    }

    fn observe(
        &mut self,
        GraphedScene { scene, graph }: GraphedScene<'_>,
    ) -> Result<AssistQuestion, PlannerError> {
        let form = match &self.source {
            AnswerSource::Model(_, asked) => asked.prompts.forms().scene_text,
            AnswerSource::Handed(_) => TextForm::Paper,
        };
        let scene_text = match form {
            TextForm::Paper | TextForm::Brief => llm_assist_text(scene, graph),
            form @ (TextForm::Compact | TextForm::Compact2) => {
                text::write(&Description::from_graph(graph), form)
            }
        };
        Ok(AssistQuestion {
            scene_text,
            score: self.score,
            speed_limit: Names::from_graph(graph).speed_limit,
        })
    }

    fn shown(&self, question: &AssistQuestion) -> Shown {
        Shown {
            image: None,
            text: Some(question.scene_text.clone()),
            forms: match &self.source {
                AnswerSource::Model(_, asked) => Some(*asked.prompts.forms()),
                AnswerSource::Handed(_) => None,
            },
        }
    }

    /// Attempts until an answer reaches τ, `max_exec` are made, or the call is interrupted.
    fn attempts(
        &mut self,
        question: &AssistQuestion,
        GraphedScene { scene, .. }: GraphedScene<'_>,
        CallTerms { seed, deadline }: CallTerms,
    ) -> Result<Attempts<Assisted>, PlannerError> {
        let tau = self.tau();
        let answers = match &self.source {
            AnswerSource::Model(variant, asked) => Answers::Asked(Box::new(AssistReasoning::open(
                *variant,
                asked.model.as_ref(),
                asked.prompts.as_ref(),
                &asked.reasoning,
                question,
                seed,
                deadline,
            )?)),
            AnswerSource::Handed(handed) => Answers::Handed(handed),
        };
        let PdmMemory {
            reference_path,
            collided,
        } = &mut self.drive.memory;
        let path = reference_path
            .as_ref()
            .expect("PDM-Closed plans along it before the model is asked");
        let started = Instant::now();
        // Over PDM-Closed's own horizon, so that an answer's score compares with τ as its proposals
        // do.
        let judge = Judge::along(scene, path, PROPOSAL_STEPS as f64 * STEP_S, collided)?;
        let observation_ms = milliseconds(started.elapsed());
        let limits = AttemptLimits {
            max_exec: self.settings.reflection.max_exec,
            threshold: tau,
            compares: false,
        };
        let mut asked = AssistCall {
            answers,
            path,
            scene,
            collided,
            judge,
            tau,
        };
        let mut attempts = Attempts::make(&mut asked, limits, observation_ms)?;
        attempts.rival = Some(self.score);
        Ok(attempts)
    }

    /// The first answer that is accepted, else the best one if it scores more than PDM-Closed's own
    /// best proposal, else PDM-Closed.
    fn decide(&self, attempts: &Attempts<Assisted>) -> Decision {
        if let Some(index) = attempts.accepted() {
            return Decision::Execute(index);
        }
        match (attempts.best(), &attempts.interruption) {
            (Some(index), _)
                if attempts
                    .rival
                    .is_some_and(|rules| attempts.score(index) > rules) =>
            {
                Decision::Exhausted(index)
            }
            (_, Some(why)) => self.without_plan(NoPlan::Interrupted(why.clone())),
            (Some(_), None) => self.without_plan(NoPlan::Outscored),
            (None, None) => self.without_plan(NoPlan::Unreadable(attempts.unreadable())),
        }
    }

    fn without_plan(&self, why: NoPlan) -> Decision {
        Decision::RuleBased(why)
    }
}

impl Planner for LlmAssist {
    fn name(&self) -> &str {
        self.name.as_str()
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        (self.drive, self.clock) = (AssistDrive::default(), Clock::default());
        self.calls.clear();
        if initialization.route.lanes(initialization.map).is_empty() {
            Err(PlannerError::EmptyRoute)
        } else {
            Ok(())
        }
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let scene = &input.scene;
        let rules = self.drive.rules(scene)?;
        self.clock.step(scene.ego.time_us);
        if self.clock.is_due(self.answer_s()) {
            self.drive.end();
            self.score = rules.scores[rules.best].total;
            if self.score < self.tau() {
                // Before the call, which counts as made also without a lane graph: else it would be
                // tried at every step.
                self.clock.set_called();
                let at_s = self.clock.elapsed_s(scene.ego.time_us);
                let (call, active) = planning_call(self, input, at_s, Instant::now())?;
                self.drive.active = active;
                self.calls.push(call);
            }
        }
        self.drive.trajectory(scene, rules)
    }

    fn calls(&self) -> &[PlanningCall] {
        &self.calls
    }

    fn take_calls(&mut self) -> Vec<PlanningCall> {
        std::mem::take(&mut self.calls)
    }
}

/// Where the answers of a planning call come from.
enum Answers<'a> {
    Asked(Box<AssistReasoning<'a>>),
    Handed(&'a HandedAnswers),
}

/// The answers of a planning call, tried out along PDM-Closed's reference path.
struct AssistCall<'a> {
    answers: Answers<'a>,
    path: &'a ReferencePath,
    scene: &'a SceneView<'a>,
    collided: &'a mut Collided,
    judge: Judge<'a>,
    tau: f64,
}

impl Question for AssistCall<'_> {
    type Answer = Assistance;
    type Plan = Assisted;

    fn ask(
        &mut self,
        feedback: Option<&Feedback>,
    ) -> Result<Option<ReasoningTrace<Assistance>>, ReasoningError> {
        match &mut self.answers {
            Answers::Asked(reasoning) => reasoning.think(feedback).map(Some),
            Answers::Handed(handed) => Ok(handed.next().map(ReasoningTrace::without_rounds)),
        }
    }

    fn try_out(&mut self, assistance: Assistance) -> Result<Option<Trial<Assisted>>, PlannerError> {
        let plan = Assisted::from_answer(&assistance, self.scene.ego)?;
        let (path, states): (Vec<Pose>, Vec<EgoState>) = match &plan {
            Assisted::Plan(trajectory) => {
                let states = trajectory.states().iter().take(PROPOSAL_STEPS + 1);
                let path = states.map(|state| state.rear_axle).collect();
                (path, self.judge.follow(trajectory))
            }
            Assisted::Parameters(parameters) => {
                let mut plan = plan_tuned(self.path, self.scene, self.collided, *parameters)?;
                let (best, states) = (
                    plan.proposals.swap_remove(plan.best),
                    plan.simulated.swap_remove(plan.best),
                );
                (best.poses, states)
            }
        };
        let reflection = Some(self.judge.assess(states, self.tau)?);
        Ok(Some(Trial {
            plan,
            path,
            reflection,
            threshold: self.tau,
        }))
    }
}

fn tuned(parameters: AssistParameters) -> PdmParameters {
    let AssistParameters {
        speed_cap,
        min_gap,
        headway,
        accel_max,
        decel_max,
        emergency_brake,
    } = parameters;
    PdmParameters {
        speed_cap: Some(speed_cap),
        min_gap,
        headway,
        accel_max,
        decel_max,
        emergency_brake,
    }
}
