//! The page of a card: sections of sentences, tables and a plot, for every form of it.

use super::calibration::Calibration;
use super::content::Card;
use super::measured::{Cost, Measured};
use super::outcome::{Part, Share};
use super::pictures::PictureAnswers;
use super::plot;
use super::scores::SourceScore;
use crate::report::twin_rows;
use planagent_runs::report::fixed;
use planagent_runs::report::table::{Table, or_dash, short, signed, three_digits, weights};
use planagent_runs::worker::interactive;
use planagent_runs::worker::statistics::PairedDifference;

/// A section of a page.
#[derive(Debug, Clone, PartialEq)]
pub struct Section {
    pub(super) title: String,
    pub(super) blocks: Vec<Block>,
}

/// A part of a section.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Block {
    Text(String),
    Table(Table),
    Plot { title: String, svg: String },
}

fn section(title: impl Into<String>, blocks: Vec<Block>) -> Section {
    Section {
        title: title.into(),
        blocks,
    }
}

fn text(words: impl Into<String>) -> Block {
    Block::Text(words.into())
}

/// The page of a card.
pub(super) fn sections(card: &Card) -> Vec<Section> {
    let mut sections = vec![about(card)];
    for own in card.scores.chunk_by(|a, b| panel(a) == panel(b)) {
        sections.extend(
            own.first()
                .map(|first| scores(&panel(first), first.scenes, own)),
        );
    }
    sections.push(planning_calls(card));
    sections.push(part(
        "Probability of the code and its regret",
        &card.calibration,
        calibration,
    ));
    sections.push(part("The picture, at states", &card.pictures, |rows| {
        pictures(rows)
    }));
    sections.push(part("Text twins", &card.twins, |twins| {
        vec![Block::Table(twin_rows(twins))]
    }));
    sections.push(reasoning(card));
    sections.push(part(
        "Measured: cost of a planning call",
        &card.measured,
        measured,
    ));
    sections
}

/// A section that may be missing, with the reason in its place.
fn part<T>(title: &str, part: &Part<T>, blocks: impl FnOnce(&T) -> Vec<Block>) -> Section {
    let missing = || part.why_not().map(text).into_iter().collect();
    section(title, part.known().map_or_else(missing, blocks))
}

fn about(card: &Card) -> Section {
    let model = &card.model;
    let size = match &model.server {
        Some(server) => format!("{} at {}", server.model, server.endpoint),
        None => format!("{} weights", weights(model.parameters)),
    };
    let adapter = model.adapter.as_ref().map_or_else(String::new, |merged| {
        format!(
            "{} ({}, {} tensors)",
            merged.path, merged.kind, merged.tensors
        )
    });
    let rows = [
        ("model", model.name.clone()),
        ("family", model.architecture.clone()),
        ("size", size),
        ("adapter", adapter),
        ("picture", if model.sees { "yes" } else { "no" }.to_owned()),
        ("prompt set", model.prompt_set.clone()),
        ("planagent", card.planagent.to_owned()),
        ("seed", card.seed.to_string()),
        ("states", card.states.asked.to_string()),
        (
            "states without an answer",
            card.states.unanswered.to_string(),
        ),
    ];
    // A model without an adapter has no row of it.
    let rows = rows.into_iter().filter(|(_, value)| !value.is_empty());
    let rows = rows.map(|(name, value)| vec![name.to_owned(), value]);
    section("About", vec![Block::Table(Table::new(["", ""], 2, rows))])
}

/// The suite and challenge of scores, as papers name them.
fn panel(score: &SourceScore) -> String {
    let name = if interactive::NAMES.contains(&score.suite.as_str()) {
        "interactive"
    } else {
        short(score.challenge)
    };
    format!("{name}: {}", score.suite)
}

fn scores(title: &str, scenes: usize, rows: &[SourceScore]) -> Section {
    let cells = rows.iter().map(|row| {
        let score = match row.not_simulated {
            Some(why) => why.to_owned(),
            None => or_dash(row.score, |score| fixed(score, 2)),
        };
        let mut cells = vec![row.source.clone(), score];
        cells.extend(difference(row.model_minus));
        cells.push(row.failed.to_string());
        cells
    });
    let headers = [
        "codes from",
        "score",
        "model minus this",
        "95 % interval",
        "failed",
    ];
    section(
        format!("Score {title}, {scenes} scenes"),
        vec![Block::Table(Table::new(headers, 1, cells))],
    )
}

/// A difference and its interval.
fn difference(found: Option<PairedDifference>) -> [String; 2] {
    [
        or_dash(found, |found| signed(found.mean)),
        or_dash(found, |found| found.interval(signed)),
    ]
}

fn planning_calls(card: &Card) -> Section {
    let headers = [
        "suite",
        "calls",
        "attempts",
        "unreadable",
        "first refused",
        "all refused",
        "kept",
        "braked",
        "interrupted",
    ];
    let rows = card.calls.iter().map(|counts| {
        // In the order of the headers.
        let numbers = [
            counts.calls,
            counts.attempts,
            counts.unreadable,
            counts.first_refused,
            counts.all_refused,
            counts.kept,
            counts.braked,
            counts.interrupted,
        ];
        let numbers = numbers.map(|number| number.to_string());
        std::iter::once(counts.suite.clone())
            .chain(numbers)
            .collect()
    });
    section(
        "Planning calls of the model",
        vec![Block::Table(Table::new(headers, 1, rows))],
    )
}

fn calibration(calibration: &Calibration) -> Vec<Block> {
    let rows = calibration.bins.iter().map(|bin| {
        let [regret, interval] = value(bin.regret, 3);
        let mut cells = vec![
            format!("{} to {}", three_digits(bin.from), three_digits(bin.to)),
            bin.right.of.to_string(),
        ];
        cells.extend(share(&bin.right));
        cells.extend([regret, interval]);
        cells
    });
    let headers = [
        "probability",
        "codes",
        "right %",
        "95 %",
        "mean regret",
        "95 % interval",
    ];
    // One number for those who read no plot.
    let order = match calibration.tau {
        Some(tau) => format!(
            "Kendall's tau of probability and regret is {}: below 0, probable codes are better ones.",
            fixed(tau, 2)
        ),
        None => "Probability and regret have no common order.".to_owned(),
    };
    vec![
        text(order),
        Block::Table(Table::new(headers, 1, rows)),
        Block::Plot {
            title: "Regret over probability".to_owned(),
            svg: plot::draw(calibration),
        },
    ]
}

/// A value and its interval.
fn value(found: Option<PairedDifference>, decimals: usize) -> [String; 2] {
    [
        or_dash(found, |found| fixed(found.mean, decimals)),
        or_dash(found, |found| found.interval(|end| fixed(end, decimals))),
    ]
}

/// A share and its interval, percent.
fn share(share: &Share) -> [String; 2] {
    let [low, high] = share.interval.map(|bound| fixed(bound, 1));
    [
        or_dash(share.percent, |percent| fixed(percent, 1)),
        or_dash(share.percent, |_| format!("{low}-{high}")),
    ]
}

fn pictures(rows: &[PictureAnswers]) -> Vec<Block> {
    let cells = rows.iter().map(|row| {
        let mut cells = vec![row.picture.to_owned(), row.same_code.of.to_string()];
        cells.extend(share(&row.same_code));
        cells.push(or_dash(row.regret, |regret| fixed(regret, 3)));
        cells.extend(value(row.difference, 3));
        cells
    });
    let headers = [
        "picture",
        "states",
        "same code %",
        "95 %",
        "mean regret",
        "minus own",
        "95 % interval",
    ];
    vec![Block::Table(Table::new(headers, 1, cells))]
}

fn reasoning(card: &Card) -> Section {
    let reasoning = &card.reasoning;
    let [percent, interval] = share(&reasoning.unchanged);
    let mut blocks = vec![text(format!(
        "With its own answers given, the model has the same code in {percent} % of {} states ({interval}).",
        reasoning.unchanged.of
    ))];
    // The shares of rounds first: a single change may be asked at few states.
    for round in &reasoning.rounds {
        let name = round.round;
        blocks.push(text(match &round.agree_percent {
            Part::Known(found) => {
                let [mean, interval] = value(Some(*found), 1);
                format!(
                    "Round {name}: after {} changes, the code agrees in {mean} % (95 % interval over states: {interval}).",
                    found.pairs
                )
            }
            Part::Missing { not_available } => {
                format!("Round {name}: not available, because {not_available}.")
            }
        }));
    }
    let rows = reasoning.changes.iter().map(|row| {
        let mut cells = vec![
            row.round.to_string(),
            row.change.to_owned(),
            row.agreeing.clone(),
            row.agree.of.to_string(),
        ];
        cells.extend(share(&row.agree));
        cells.extend(share(&row.differ).into_iter().take(1));
        cells
    });
    let headers = [
        "round",
        "changed to",
        "codes that agree",
        "states",
        "agree %",
        "95 %",
        "differ %",
    ];
    blocks.push(Block::Table(Table::new(headers, 3, rows)));
    section("Does the reasoning matter?", blocks)
}

fn measured(measured: &Measured) -> Vec<Block> {
    let cost = &measured.cost;
    let row = |unit: &str, cost: &Cost| {
        vec![
            cost.of.clone(),
            unit.to_owned(),
            three_digits(cost.p50),
            three_digits(cost.p95),
        ]
    };
    // Times and counts share a table, since both are what a call costs.
    let stages = cost.stages.iter().map(|stage| row("ms", stage));
    let tokens = cost.tokens.iter().map(|tokens| row("", tokens));
    let table = Table::new(["of a call", "unit", "p50", "p95"], 2, stages.chain(tokens));
    let late = measured.late.iter().map(|row| {
        let mut cells = vec![panel(row), or_dash(row.score, |score| fixed(score, 2))];
        cells.extend(difference(row.model_minus));
        cells
    });
    let headers = [
        "plans come late",
        "score",
        "model minus this",
        "95 % interval",
    ];
    vec![
        text(format!(
            "{} calls on this machine, several simulations side by side.",
            cost.calls
        )),
        Block::Table(table),
        text(format!(
            "The same loop, in which the plan of a call becomes active {} ms after it began.",
            cost.latency_ms
        )),
        Block::Table(Table::new(headers, 1, late)),
    ]
}
