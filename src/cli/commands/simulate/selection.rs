//! What a run drives: from the flags, else from the run that is gone on with, else by default.

use crate::cli::Printer;
use crate::cli::args::SimulateArguments;
use crate::experiment::run::SimulationTask;
use crate::experiment::split::split;
use crate::planner::{PlannerName, PlannerRegistry};
use crate::report::{Manifest, ScenarioList};
use crate::scenario::{DataRoots, MissingTokens, Readers, ScenarioRef, absolute_path, generator};
use crate::simulation::Challenge;
use anyhow::{Context, bail};
use std::path::PathBuf;

/// What a run drives.
pub(super) struct Selection {
    /// The scenarios, as the manifest tells of them.
    pub(super) list: ScenarioList,
    /// Planners in their order.
    pub(super) planners: Vec<PlannerName>,
    /// Challenges in their order.
    pub(super) challenges: Vec<Challenge>,
    /// Every scenario with every planner in every challenge.
    pub(super) tasks: Vec<SimulationTask>,
    /// The readers that found the scenarios; they keep nuPlan's maps, and notes for the user.
    pub(super) readers: Readers,
}

/// What words and splits name.
pub(in crate::cli) struct Found {
    /// The scenarios, each once.
    pub(in crate::cli) sources: Vec<ScenarioRef>,
    /// The splits: their files, else their names.
    pub(in crate::cli) splits: Vec<String>,
    /// What the splits name and the data does not hold.
    pub(in crate::cli) missing: Vec<MissingTokens>,
}

impl Selection {
    /// Finds everything that is to be driven.
    ///
    /// # Errors
    /// When a planner, challenge, split or scenario is unknown or cannot be read, or nothing is left.
    pub(super) fn of(flags: &SimulateArguments, manifest: Option<&Manifest>, printer: Printer) -> anyhow::Result<Self> {
        let planners = planners(&flags.planner, manifest)?;
        let challenges = challenges(&flags.challenge, manifest)?;
        let (words, splits, limit) = match manifest {
            Some(manifest) if !flags.names_scenarios() => {
                let list = &manifest.scenarios;
                (list.words.clone(), list.splits.clone(), list.limit)
            }
            _ => (flags.scenarios.clone(), flags.split.splits.clone(), flags.limit),
        };
        // A run is gone on with from any folder: nothing of it may hang on this one.
        let roots = roots(flags, manifest)?;
        let readers = Readers::new(&roots);
        let words: Vec<String> = words.iter().map(|word| readers.absolute_word(word)).collect();
        let Found { sources, splits, missing } = find(&words, &splits, limit, &readers, printer)?;
        sources.iter().try_for_each(ScenarioRef::check)?;
        let names = sources.iter().map(ToString::to_string);
        let (count, blake3) = (sources.len(), ScenarioList::digest(names));
        let DataRoots { data: data_root, maps: maps_root } = roots;
        let list = ScenarioList { words, splits, data_root, maps_root, limit, count, blake3, missing };
        let tasks = tasks(&sources, &planners, &challenges);
        Ok(Self { list, planners, challenges, tasks, readers })
    }

    /// The same, if its scenarios are those of a run.
    ///
    /// # Errors
    /// When the data holds others now.
    pub(super) fn check_unchanged(self, manifest: &Manifest) -> anyhow::Result<Self> {
        let (then, now) = (&manifest.scenarios, &self.list);
        if then.blake3 != now.blake3 {
            bail!(
                "its {} scenarios are not those that are found now ({}) by {}",
                then.count,
                now.count,
                [&then.words[..], &then.splits[..]].concat().join(" ")
            );
        }
        Ok(self)
    }
}

/// The folders of nuPlan's data by flags or environment, else those of the run that is gone on with; absolute.
fn roots(flags: &SimulateArguments, manifest: Option<&Manifest>) -> anyhow::Result<DataRoots> {
    let DataRoots { data, maps } = flags.split.data.roots();
    let before = |of: fn(&ScenarioList) -> &Option<PathBuf>| manifest.and_then(|m| of(&m.scenarios).clone());
    let absolute = |folder: Option<PathBuf>| folder.map(std::path::absolute).transpose();
    Ok(DataRoots {
        data: absolute(data.or_else(|| before(|l| &l.data_root)))?,
        maps: absolute(maps.or_else(|| before(|l| &l.maps_root)))?,
    })
}

/// Finds what words and splits name, or the default scene where nothing is named.
///
/// # Errors
/// When a split or scenario is unknown or cannot be read, or nothing is left.
pub(in crate::cli) fn find(
    words: &[String],
    splits: &[String],
    limit: Option<usize>,
    readers: &Readers,
    printer: Printer,
) -> anyhow::Result<Found> {
    let (mut found, mut missing, mut lists) = (Vec::new(), Vec::new(), Vec::new());
    for name in splits {
        let bar = printer.progress(0, "logs");
        let of_split = split(name, readers, &|done, all| {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
        });
        bar.finish_and_clear();
        let of_split = of_split?;
        found.extend(of_split.scenarios);
        for note in of_split.notes {
            printer.note(format!("{name}: {note}"));
        }
        if !of_split.missing.is_empty() {
            printer.note(of_split.missing.to_string());
            missing.push(of_split.missing);
        }
        lists.push(match of_split.file {
            Some(file) => absolute_path(&file.to_string_lossy()),
            None => name.clone(),
        });
    }
    for word in words {
        found.extend(readers.find(word)?);
    }
    if splits.is_empty() && words.is_empty() {
        found.push(generator::DEFAULT.into());
    }
    for note in readers.take_notes() {
        printer.note(note);
    }
    // A scenario that is named twice is driven once, or it would count twice in the means.
    let (mut sources, again) = ScenarioRef::distinct(found);
    if let Some(first) = again.first() {
        printer
            .note(format!("{} scenarios are named more than once and driven once, for example {first}", again.len()));
    }
    sources.truncate(limit.unwrap_or(usize::MAX));
    if sources.is_empty() {
        bail!("no scenario is left to drive");
    }
    Ok(Found { sources, splits: lists, missing })
}

fn planners(flags: &[String], manifest: Option<&Manifest>) -> anyhow::Result<Vec<PlannerName>> {
    let names = match manifest {
        Some(manifest) if flags.is_empty() => &manifest.planners,
        _ => flags,
    };
    let registry = PlannerRegistry::default();
    let mut planners: Vec<PlannerName> = Vec::new();
    for name in names {
        let planner = registry.find(name)?.name;
        if !planners.contains(&planner) {
            planners.push(planner);
        }
    }
    if planners.is_empty() {
        planners.push(PlannerName::PLAN_AGENT);
    }
    Ok(planners)
}

fn challenges(flags: &[String], manifest: Option<&Manifest>) -> anyhow::Result<Vec<Challenge>> {
    let names = match manifest {
        Some(manifest) if flags.is_empty() => &manifest.challenges,
        _ => flags,
    };
    let mut challenges: Vec<Challenge> = Vec::new();
    for name in names {
        let named = match name.as_str() {
            "both" => Challenge::CLOSED_LOOP.to_vec(),
            one => vec![one.parse().context("--challenge takes nonreactive, reactive, both or open-loop")?],
        };
        for challenge in named {
            if !challenges.contains(&challenge) {
                challenges.push(challenge);
            }
        }
    }
    if challenges.is_empty() {
        challenges.push(Challenge::NonReactive);
    }
    Ok(challenges)
}

/// Every scenario with every planner in every challenge.
pub(in crate::cli) fn tasks(
    sources: &[ScenarioRef],
    planners: &[PlannerName],
    challenges: &[Challenge],
) -> Vec<SimulationTask> {
    let mut all = Vec::with_capacity(sources.len() * planners.len() * challenges.len());
    for source in sources {
        for &planner in planners {
            all.extend(challenges.iter().map(|&challenge| SimulationTask {
                source: source.clone(),
                planner,
                challenge,
            }));
        }
    }
    all
}
