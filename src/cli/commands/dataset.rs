//! `planagent dataset`.

use crate::args::{DatasetArguments, DatasetKind};
use crate::progress::listener;
use crate::{Exit, Printer, interrupt};
use anyhow::{Context, bail};
use planagent_agent::environment::BevView;
use planagent_agent::reasoning::PromptSet;
#[cfg(feature = "learned")]
use planagent_lab::dataset::imitation::{ImitationPlanner, ImitationSource, write_samples};
use planagent_lab::dataset::{
    Chats, Counts, MessageModel, Settings, check_folder, check_messages, teacher,
    write_message_card, write_messages, write_split, write_twins,
};
use planagent_mllm::ModelSource;
use planagent_runs::report::check_writable;
use planagent_runs::runner::{Config, load_model, model_registry};
use planagent_runs::worker::seeds::Split;
#[cfg(feature = "learned")]
use planagent_scenario::Readers;
#[cfg(feature = "learned")]
use std::time::Instant;

/// Prompt set of datasets: that of the models that are trained on them.
const PROMPT_SET: &str = "compact";
/// Planner of a dataset for imitation that names none.
#[cfg(feature = "learned")]
const DEFAULT_PLANNER: &str = "plantf";

/// Writes labeled states.
pub(crate) fn run(
    flags: &DatasetArguments,
    config: &Config,
    printer: Printer,
) -> anyhow::Result<Exit> {
    check_writable(&flags.out)?;
    interrupt::advise("the same command goes on", printer)?;
    // Before a folder begins that may take hours.
    check_options(flags)?;
    match flags.kind {
        DatasetKind::Labels => labels(flags, config, printer),
        DatasetKind::Messages => messages(flags, config, printer),
        DatasetKind::Imitation => imitation(flags, config, printer),
    }
}

/// Writes labeled states as nano's trainer reads them.
fn labels(flags: &DatasetArguments, config: &Config, printer: Printer) -> anyhow::Result<Exit> {
    let prompts = PromptSet::open(config.reasoning.prompt_set.as_deref().unwrap_or(PROMPT_SET))?;
    let view = BevView::new(BevView::default().pixels(), config.environment.view_m)?;
    let settings = Settings {
        seed: config.seed,
        prompts: &prompts,
        view,
        driver: None,
        modified: flags.modified,
    };
    check_folder(&flags.out, &settings)?;
    let driver = if flags.driven {
        let listener = listener(printer);
        Some(load_model(config, &listener)?.agent_parts(config, &listener)?)
    } else {
        None
    };
    let settings = Settings {
        driver: driver.as_ref(),
        ..settings
    };
    let splits = [
        (Split::Train, flags.states),
        (Split::Validation, flags.validation),
    ];
    // States that a model reached are for training alone.
    for (split, states) in splits
        .into_iter()
        .filter(|(split, _)| *split == Split::Train || !flags.driven)
    {
        let bar = printer.progress(states as u64, "states");
        bar.set_message(split.as_str());
        let written = write_split(&flags.out, split, states, &settings, &|states| {
            bar.inc(states as u64);
        })?;
        bar.finish_and_clear();
        printer.note(format!("{}: {written} states", split.as_str()));
    }
    for (split, pairs) in [
        (Split::Train, flags.twins),
        (Split::Validation, flags.validation_twins),
    ] {
        let bar = printer.progress(pairs as u64, "pairs");
        bar.set_message(format!("{} twins", split.as_str()));
        let written = write_twins(&flags.out, split, pairs, &settings, &|pairs| {
            bar.inc(pairs as u64);
        })?;
        bar.finish_and_clear();
        if pairs > 0 {
            printer.note(format!("{}: {written} pairs of text twins", split.as_str()));
        }
    }
    for split in [Split::Train, Split::Validation] {
        let counts = Counts::read(&flags.out, split.as_str())?;
        if printer.is_json() {
            printer.json(&serde_json::json!({"split": split.as_str(), "states": counts.states, "counts": counts}))?;
        } else if counts.states > 0 {
            printer.note(format!("{}: {counts}", split.as_str()));
        }
    }
    Ok(Exit::Success)
}

/// Writes conversations, preferences and tried codes as other trainers read them.
fn messages(flags: &DatasetArguments, config: &Config, printer: Printer) -> anyhow::Result<Exit> {
    let (model, prompt_set) = message_model(config, printer)?;
    let prompts = PromptSet::open(&prompt_set)?;
    // A view is drawn for a model that reads text alone, too, and written nowhere.
    let pixels = model.image_pixels.unwrap_or(BevView::default().pixels());
    let settings = Settings {
        seed: config.seed,
        prompts: &prompts,
        view: BevView::new(pixels, config.environment.view_m)?,
        driver: None,
        modified: flags.modified,
    };
    let mut teachers = Vec::new();
    for name in &flags.agents {
        teachers.extend(teacher(name)?);
    }
    let chats = Chats {
        model: &model,
        teachers: &teachers,
    };
    check_messages(&flags.out, &settings, chats)?;
    for (split, states) in [
        (Split::Train, flags.states),
        (Split::Validation, flags.validation),
    ] {
        let bar = printer.progress(states as u64, "states");
        bar.set_message(split.as_str());
        let written = write_messages(&flags.out, split, states, &settings, chats, &|states| {
            bar.inc(states as u64);
        })?;
        bar.finish_and_clear();
        printer.note(format!("{}: {written} conversations", split.as_str()));
        if printer.is_json() {
            printer
                .json(&serde_json::json!({"split": split.as_str(), "conversations": written}))?;
        }
    }
    write_message_card(&flags.out, &settings, chats)?;
    printer.note(format!(
        "data card: {}",
        flags.out.join("README.md").display()
    ));
    Ok(Exit::Success)
}

/// What is known of the configured model without its weights, and its prompt set.
fn message_model(config: &Config, printer: Printer) -> anyhow::Result<(MessageModel, String)> {
    let registry = model_registry(config, &listener(printer));
    let spec = registry.find(&config.mllm.model)?;
    let asking = registry.asking_here(&spec);
    let prompt_set = match &config.reasoning.prompt_set {
        Some(set) => set.clone(),
        None => asking?.prompt_set,
    };
    let (image_pixels, image_tokens) = if let ModelSource::Endpoint(server) = &spec.source {
        (Some(server.image_size), None)
    } else {
        let outline = registry.outline(&spec).with_context(|| {
            format!(
                "--model {}: neither its files nor the shape of its repository are known here",
                config.mllm.model
            )
        })?;
        let pixels = outline.image_size.map(|pixels| pixels as u32);
        (pixels, pixels.map(|_| outline.image_tokens))
    };
    let model = MessageModel {
        name: spec.name,
        image_pixels: image_pixels.filter(|_| config.environment.bev),
        image_tokens,
    };
    Ok((model, prompt_set))
}

/// Refuses options of the other kinds of dataset.
fn check_options(flags: &DatasetArguments) -> anyhow::Result<()> {
    let of_labels = [
        ("--driven", flags.driven),
        ("--twins", flags.twins > 0),
        ("--validation-twins", flags.validation_twins > 0),
    ];
    let of_messages = [("--agents", !flags.agents.is_empty())];
    let modified = [("--modified", flags.modified > 0.0)];
    #[cfg(feature = "learned")]
    let of_imitation = [
        ("--planner", flags.planner.is_some()),
        ("--scenario", !flags.scenarios.is_empty()),
        ("--modify", flags.data.modifies()),
    ];
    #[cfg(not(feature = "learned"))]
    let of_imitation = [];
    // Options that another kind has.
    let foreign: &[(&str, &[(&str, bool)])] = match flags.kind {
        DatasetKind::Labels => &[("imitation", &of_imitation), ("messages", &of_messages)],
        DatasetKind::Messages => &[("imitation", &of_imitation), ("labels", &of_labels)],
        DatasetKind::Imitation => &[
            ("labels", &of_labels),
            ("labels", &modified),
            ("messages", &of_messages),
        ],
    };
    for (kind, options) in foreign {
        if let Some((option, _)) = options.iter().find(|(_, is_given)| *is_given) {
            bail!("{option} belongs to --for {kind}");
        }
    }
    Ok(())
}

/// Writes the samples of a learned planner.
#[cfg(feature = "learned")]
fn imitation(flags: &DatasetArguments, config: &Config, printer: Printer) -> anyhow::Result<Exit> {
    let name = flags.planner.as_deref().unwrap_or(DEFAULT_PLANNER);
    let planner = ImitationPlanner::ALL
        .into_iter()
        .find(|planner| planner.name() == name);
    let planner =
        planner.with_context(|| format!("--planner {name}: no dataset is made for it"))?;
    let readers = Readers::new(&flags.data.roots());
    let mut listed = Vec::new();
    for word in &flags.data.modified(&flags.scenarios)? {
        listed.extend(readers.find(word)?);
    }
    readers
        .take_notes()
        .into_iter()
        .for_each(|text| printer.note(text));
    let generated = |split| {
        (
            split,
            ImitationSource::Generated {
                split,
                seed: config.seed,
            },
        )
    };
    // Scenarios that a user lists are not split: which of them validate is the user's choice.
    let splits = if listed.is_empty() {
        vec![
            (generated(Split::Train), flags.states),
            (generated(Split::Validation), flags.validation),
        ]
    } else {
        vec![(
            (Split::Train, ImitationSource::Listed(&listed)),
            flags.states,
        )]
    };
    for ((split, source), samples) in splits {
        let bar = printer.progress(samples as u64, "samples");
        bar.set_message(split.as_str());
        let started = Instant::now();
        let written = write_samples(&flags.out, planner, source, samples, &|samples| {
            bar.inc(samples as u64);
        })?;
        bar.finish_and_clear();
        let minutes = started.elapsed().as_secs_f64() / 60.0;
        printer.note(format!(
            "{}: {written} samples in {minutes:.1} minutes",
            split.as_str()
        ));
        if printer.is_json() {
            printer.json(&serde_json::json!({"split": split.as_str(), "samples": written}))?;
        }
    }
    Ok(Exit::Success)
}

#[cfg(not(feature = "learned"))]
fn imitation(_: &DatasetArguments, _: &Config, _: Printer) -> anyhow::Result<Exit> {
    bail!("--for imitation: this program was built without the cargo feature learned")
}
