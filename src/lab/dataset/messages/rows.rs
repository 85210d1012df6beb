//! The lines of the files: conversations, lessons, preferences, tried codes.

use super::answers::{self, Seen};
use super::{Chats, MessageModel, images};
use crate::dataset::Settings;
use crate::dataset::label::{self, Instruction};
use crate::dataset::lessons::lessons;
use crate::dataset::refusal::refusal;
use crate::dataset::reward::RewardOutcome;
use crate::dataset::state_name::{StateName, driven_text};
use crate::dataset::states::VisitedState;
use image::RgbImage;
use planagent_agent::environment::text::{self, Description};
use planagent_agent::reasoning::{
    Feedback, Names, PromptError, Round, feedback_text, round_prompt, system_prompt,
};
use planagent_agent::reflection::SubScores;
use planagent_controls::search::Candidate;
use planagent_language_agents::{SearchedState, TaughtAnswer};
use serde::Serialize;

/// A turn of a chat.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Message {
    role: &'static str,
    content: String,
}

impl Message {
    fn user(content: String) -> Self {
        Self {
            role: "user",
            content,
        }
    }

    fn assistant(content: String) -> Self {
        Self {
            role: "assistant",
            content,
        }
    }
}

/// A line of the conversations.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Conversation {
    pub(super) messages: Vec<Message>,
    /// Path of the picture in the dataset's folder; left out for a model that reads text alone.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) images: Vec<String>,
    /// Whether the first prompt reports a code that Reflection refused.
    pub(super) rethink: bool,
    pub(super) state: StateName,
}

/// A line of the lessons: a conversation that ends in one of the codes worth learning.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct LessonConversation {
    #[serde(flatten)]
    conversation: Conversation,
    /// Its chance among the lessons of the state, 0 to 1; they sum up to 1.
    chance: f64,
    /// What the decisions of the state gain over their worst options, in scores.
    weight: f64,
    /// That of the tried code.
    value: f64,
}

/// A line of the preferences: the same in the columns of each trainer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Preference {
    /// The round whose answers differ: `instruction` or `code`.
    round: &'static str,
    /// The chat before the answer.
    prompt: Vec<Message>,
    chosen: [Message; 1],
    rejected: [Message; 1],
    /// The answers without a list around them, as LLaMA-Factory reads them.
    chosen_message: Message,
    rejected_message: Message,
    /// The chat with the accepted answer, and the refused one, as ms-swift reads them.
    messages: Vec<Message>,
    rejected_response: String,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    images: Vec<String>,
    /// What the agent says to the model of the refused code.
    feedback: String,
    chosen_code: String,
    rejected_code: String,
    state: StateName,
}

/// A line of the tried codes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct TriedCode {
    state: StateName,
    /// The answer of round 3.
    answer: String,
    /// `scored` or `refused`.
    outcome: &'static str,
    /// nuPlan's score over six seconds, with the terms that break ties: the reward.
    value: f64,
    /// nuPlan's score over six seconds, 0 to 1.
    score: f64,
    /// Reflection's score, 0 to 1, and its parts.
    reflection: f64,
    parts: SubScores,
    /// Why Reflection refuses it; empty if it does not.
    reason: String,
    /// Whether it is the label of the state.
    best: bool,
    /// The chat before the answer, with the label's answers of the rounds before.
    prompt: Vec<Message>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    images: Vec<String>,
}

/// A line of the conversations of another agent.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct AgentConversation {
    messages: [Message; 3],
    state: StateName,
}

impl AgentConversation {
    fn new(taught: TaughtAnswer, state: StateName) -> Self {
        let system = Message {
            role: "system",
            content: taught.system,
        };
        let messages = [
            system,
            Message::user(taught.prompt),
            Message::assistant(taught.answer),
        ];
        Self { messages, state }
    }
}

/// All lines of one state, with its picture.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rows {
    pub(super) conversation: Conversation,
    pub(super) lessons: Vec<LessonConversation>,
    pub(super) preferences: Vec<Preference>,
    pub(super) codes: Vec<TriedCode>,
    /// Those of other agents, in the order of their teachers; `None` where the search finds no answer
    /// of an agent's form.
    pub(super) agents: Vec<Option<AgentConversation>>,
    /// None for a model that reads text alone.
    pub(super) image: Option<RgbImage>,
}

impl Rows {
    /// Sets the path of the picture in all lines.
    pub(super) fn show(&mut self, path: &str) {
        let shown = || vec![path.to_owned()];
        self.conversation.images = shown();
        self.lessons
            .iter_mut()
            .for_each(|row| row.conversation.images = shown());
        self.preferences
            .iter_mut()
            .for_each(|row| row.images = shown());
        self.codes.iter_mut().for_each(|row| row.images = shown());
    }

    /// The lines of a state. The first prompt of the conversation has `feedback` on a refused code,
    /// if any; the preferences and the tried codes are those of a first attempt.
    pub(super) fn of_state(
        visited: &VisitedState<'_>,
        feedback: Option<&Feedback>,
        settings: &Settings<'_>,
        chats: Chats<'_>,
    ) -> Result<Self, PromptError> {
        // A code is preferred whatever was refused before, so preferences have no feedback.
        let first = Chat::of_state(visited, None, settings, chats.model)?;
        let state = StateName {
            scenario: visited.simulation.scenario().id.clone(),
            seed: settings.seed,
            time_s: visited.time_s(),
            challenge: visited.challenge.short_name().to_owned(),
            scene_text: settings.prompts.forms().scene_text,
            driven: driven_text(visited.driven),
        };
        let chat = match feedback {
            Some(feedback) => Chat::of_state(visited, Some(feedback), settings, chats.model)?,
            None => first.clone(),
        };
        let conversation = |candidate: &Candidate| Conversation {
            messages: chat.whole(candidate),
            images: Vec::new(),
            rethink: feedback.is_some(),
            state: state.clone(),
        };
        let lessons = lessons(visited.best, visited.tried, feedback.is_some());
        let lessons = lessons.iter().map(|lesson| LessonConversation {
            conversation: conversation(lesson.candidate),
            chance: lesson.chance,
            weight: lesson.weights.sum(),
            value: lesson.candidate.value,
        });
        let codes = visited.tried.iter().map(|tried| TriedCode {
            state: state.clone(),
            answer: tried.code.to_string(),
            outcome: RewardOutcome::from_report(&tried.reflection).as_str(),
            value: tried.value,
            score: tried.score,
            reflection: tried.reflection.score,
            parts: tried.reflection.parts,
            reason: refusal(&tried.reflection),
            best: tried.code == visited.best.code,
            prompt: first.before_code(visited.best),
            images: Vec::new(),
        });
        let searched = SearchedState {
            simulation: visited.simulation,
            graph: visited.graph,
            best: visited.best,
        };
        let agents = chats.teachers.iter().map(|teacher| {
            let taught = teacher.teach(searched)?;
            Ok(taught.map(|taught| AgentConversation::new(taught, state.clone())))
        });
        let refused = visited.tried.iter().filter(|tried| !tried.is_accepted());
        let preferences = refused
            .filter(|_| visited.best.is_accepted())
            .map(|refused| first.preference(visited.best, refused, &state, settings));
        Ok(Self {
            agents: agents.collect::<Result<_, PromptError>>()?,
            preferences: preferences.collect::<Result<_, _>>()?,
            codes: codes.collect(),
            lessons: lessons.collect(),
            conversation: conversation(visited.best),
            image: chats.model.image_pixels.map(|_| visited.image.clone()),
        })
    }
}

/// The prompts of a state, and what its answers are made from.
#[derive(Clone)]
struct Chat<'a> {
    system: String,
    /// Of the three rounds.
    prompts: Vec<String>,
    understanding: String,
    instruct: Instruct<'a>,
}

/// How the instruction of a code is written.
#[derive(Clone, Copy)]
struct Instruct<'a> {
    seen: Seen<'a>,
    settings: &'a Settings<'a>,
}

impl Instruct<'_> {
    fn decide(&self, code: &Candidate) -> Instruction {
        let Seen { graph, facts } = self.seen;
        label::instruction(
            graph,
            facts,
            code,
            label::limit(graph, self.settings.prompts),
        )
    }

    fn answer(&self, code: &Candidate) -> String {
        let form = self.settings.prompts.forms().instruction;
        answers::instruction(form, self.decide(code))
    }
}

impl<'a> Chat<'a> {
    fn of_state(
        visited: &VisitedState<'a>,
        feedback: Option<&Feedback>,
        settings: &'a Settings<'a>,
        model: &MessageModel,
    ) -> Result<Self, PromptError> {
        let VisitedState { graph, facts, .. } = *visited;
        let prompts = settings.prompts;
        let forms = prompts.forms();
        let scene_text = text::write(&Description::from_graph(graph), forms.scene_text);
        let names = Names::from_graph(graph);
        let feedback = feedback
            .map(|feedback| feedback_text(prompts, feedback))
            .transpose()?;
        // The prompts are those of the agent, word for word.
        let asked = Round::ALL.iter().map(|&round| {
            let first = round == Round::Understanding;
            let prompt = round_prompt(
                prompts,
                round,
                &names,
                first.then_some(scene_text.as_str()),
                feedback.as_deref().filter(|_| first),
            )?;
            Ok(if first && model.image_pixels.is_some() {
                format!("{}\n{prompt}", images::PLACE)
            } else {
                prompt
            })
        });
        let seen = Seen { graph, facts };
        Ok(Self {
            system: system_prompt(prompts, &model.legend())?,
            prompts: asked.collect::<Result<_, PromptError>>()?,
            understanding: answers::understanding(forms.understanding, seen),
            instruct: Instruct { seen, settings },
        })
    }

    /// The chat up to a round's prompt, with answers before it.
    fn before(&self, answers: &[String]) -> Vec<Message> {
        let system = Message {
            role: "system",
            content: self.system.clone(),
        };
        let mut messages = vec![system];
        for (index, prompt) in self.prompts.iter().enumerate().take(answers.len() + 1) {
            messages.push(Message::user(prompt.clone()));
            if let Some(answer) = answers.get(index) {
                messages.push(Message::assistant(answer.clone()));
            }
        }
        messages
    }

    fn before_code(&self, best: &Candidate) -> Vec<Message> {
        self.before(&[self.understanding.clone(), self.instruct.answer(best)])
    }

    fn whole(&self, best: &Candidate) -> Vec<Message> {
        let mut messages = self.before_code(best);
        messages.push(Message::assistant(best.code.to_string()));
        messages
    }

    /// The first answers that lead to an accepted and to a refused code and differ.
    fn preference(
        &self,
        accepted: &Candidate,
        refused: &Candidate,
        state: &StateName,
        settings: &Settings<'_>,
    ) -> Result<Preference, PromptError> {
        let (good, bad) = (
            self.instruct.answer(accepted),
            self.instruct.answer(refused),
        );
        // A code that contradicts the instruction before it would teach consistency alone.
        let (round, prompt, good, bad) = if good == bad {
            let prompt = self.before_code(accepted);
            let (good, bad) = (accepted.code.to_string(), refused.code.to_string());
            (Round::Code, prompt, good, bad)
        } else {
            let prompt = self.before(std::slice::from_ref(&self.understanding));
            (Round::Instruction, prompt, good, bad)
        };
        let mut messages = prompt.clone();
        messages.push(Message::assistant(good.clone()));
        Ok(Preference {
            round: round.as_str(),
            chosen: [Message::assistant(good.clone())],
            rejected: [Message::assistant(bad.clone())],
            chosen_message: Message::assistant(good),
            rejected_message: Message::assistant(bad.clone()),
            prompt,
            messages,
            rejected_response: bad,
            images: Vec::new(),
            feedback: feedback_text(settings.prompts, &refused.feedback())?,
            chosen_code: accepted.code.to_string(),
            rejected_code: refused.code.to_string(),
            state: state.clone(),
        })
    }
}
