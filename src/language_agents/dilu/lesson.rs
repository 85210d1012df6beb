//! What a drive leaves in the memory: decisions of a drive without an accident, and after an
//! accident the corrected decision that led to it.

use super::answer::{grammar, read_action};
use super::item::{DELIMITER, DiluItem, ends_with};
use super::{KEYS, prompts};
use crate::chat::{Asked, Chat};
use crate::fill::{LeftDrive, LeftItems, item};
use minijinja::context;
use planagent_agent::planner::{AskedModel, PlannerError, PlanningCall};
use planagent_agent::reasoning::{DrivingAction, PlannerAnswer, ReasoningError, RoundName};
use planagent_files::shortened;
use planagent_mllm::Deadline;

/// Of a drive without an accident, every fifth decision is remembered, from the first on.
const EVERY: usize = 5;

/// A decision of a drive.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DriveCall {
    /// Its iteration.
    pub(crate) iteration: usize,
    /// The scene in words.
    pub(crate) description: String,
    /// Reasoning and action as they were written.
    pub(crate) answer: String,
    /// The action.
    pub(crate) action: DrivingAction,
}

/// A drive of DiLu.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Drive {
    /// Its decisions that were carried out.
    pub(crate) calls: Vec<DriveCall>,
    /// The iteration of its first collision.
    pub(crate) collided_at: Option<usize>,
}

impl Drive {
    /// The drive of these planning calls.
    pub(crate) fn new(calls: &[PlanningCall], collided_at: Option<usize>) -> Self {
        let carried_out = calls.iter().filter_map(|call| {
            let attempt = call.accepted()?;
            let Some(PlannerAnswer::Action(action)) = attempt.answer else {
                return None;
            };
            let first = &attempt.rounds.first()?.answer;
            let answer = with_action(first, action);
            let description = call.scene_text.clone()?;
            Some(DriveCall {
                iteration: call.iteration,
                description,
                answer,
                action,
            })
        });
        Self {
            calls: carried_out.collect(),
            collided_at,
        }
    }

    /// The last decision before the collision that did not brake: the one to learn from.
    fn mistake(&self) -> Option<&DriveCall> {
        let before = self.collided_at?;
        self.calls
            .iter()
            .rev()
            .filter(|call| call.iteration < before)
            .find(|call| call.action != DrivingAction::Slower)
    }
}

/// An answer that ends with its action, also where the model named it only when asked again. Of a
/// long one a part is left out.
fn with_action(answer: &str, action: DrivingAction) -> String {
    let answer = shortened(answer);
    if ends_with(&answer, action) {
        return answer.into_owned();
    }
    format!("{}\n{DELIMITER} {}", answer.trim_end(), action.id())
}

/// What a drive leaves, as JSON.
pub(super) fn left_items(
    LeftDrive {
        scenario,
        calls,
        collided_at,
        asked,
        settings,
        seed,
    }: &LeftDrive<'_>,
) -> Result<LeftItems, PlannerError> {
    let drive = Drive::new(calls, *collided_at);
    let left = lesson_items(scenario, &drive, asked, settings.max_tokens(&KEYS), *seed)?;
    Ok(left.map(|items| items.into_iter().filter_map(item).collect()))
}

/// What a drive in a scenario of this name leaves. After an accident the model is asked for the
/// lesson; an answer without a corrected action leaves nothing, and the text says why.
///
/// # Errors
/// When the model cannot be asked at all.
pub(crate) fn lesson_items(
    scenario: &str,
    drive: &Drive,
    AskedModel {
        model, reasoning, ..
    }: &AskedModel,
    max_tokens: usize,
    seed: u64,
) -> Result<Result<Vec<DiluItem>, String>, PlannerError> {
    if drive.collided_at.is_none() {
        let kept = drive.calls.iter().step_by(EVERY).map(|call| DiluItem {
            description: call.description.clone(),
            answer: call.answer.clone(),
            action: call.action,
            comment: format!("{scenario}, iteration {}: no accident", call.iteration),
        });
        return Ok(Ok(kept.collect()));
    }
    let Some(mistake) = drive.mistake() else {
        return Ok(Err(
            "no decision before the collision did anything but brake".to_owned(),
        ));
    };
    let prompts = prompts().map_err(ReasoningError::from)?;
    let render = |template, values| {
        prompts
            .render(template, values)
            .map_err(ReasoningError::from)
    };
    let mut chat = Chat::new(model.as_ref(), reasoning, seed, Deadline::NONE);
    chat.open(render("lesson_system", context! {})?)?;
    let prompt = render(
        "lesson",
        context! { description => &mistake.description, answer => &mistake.answer },
    )?;
    let asked = Asked {
        round: RoundName::Lesson,
        prompt,
        constraint: grammar(DrivingAction::ALL),
        max_tokens,
    };
    let Some(text) = chat.ask(asked)? else {
        let why = chat
            .interruption
            .map_or_else(String::new, |why| format!("{why:?}"));
        return Ok(Err(format!("the lesson was interrupted: {why}")));
    };
    let reply = read_action(&text, DrivingAction::ALL, &chat);
    let Some(action) = reply.answer else {
        let errors: Vec<String> = reply.errors.iter().map(ToString::to_string).collect();
        return Ok(Err(format!(
            "the lesson has no action: {}",
            errors.join("; ")
        )));
    };
    let lesson = text
        .rsplit_once(DELIMITER)
        .map_or(text.as_str(), |(lesson, _)| lesson)
        .trim();
    if lesson.is_empty() {
        return Ok(Err("the lesson has an action and no words".to_owned()));
    }
    // The lesson takes the form of an answer, because remembered decisions are shown as answers.
    Ok(Ok(vec![DiluItem {
        description: mistake.description.clone(),
        answer: format!(
            "I made a mistake like this before. {}\n{DELIMITER} {}",
            shortened(lesson),
            action.id()
        ),
        action,
        comment: format!(
            "{scenario}, iteration {}: {} led to a collision",
            mistake.iteration, mistake.action
        ),
    }]))
}
