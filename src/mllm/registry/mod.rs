//! Models by name: a description in `models/`, a folder, a GGUF file, a repository of the hub, or a
//! server.

mod address;
mod built_in;
mod described_prompts;
mod description;
mod find;
mod folder;
mod generation;
#[cfg_attr(
    not(feature = "hub"),
    allow(dead_code, reason = "only downloads read what a repository has")
)]
mod hub;
mod inputs;
mod model_source;
mod own_settings;
mod without_tower;

pub use described_prompts::{DescribedPrompts, PromptSet};
pub use description::ModelSpec;
pub use folder::{data_folder, models_folder};
pub use generation::{GenerationSettings, RoundTokens};
pub use hub::{FetchListener, FetchProgress, HubAccess, offline_variable};
pub use inputs::ModelInputs;
pub use model_source::ModelSource;
pub use own_settings::{Asking, NamedBy};

use super::source::Checkpoint;
use super::trial::Trust;
use super::{
    AdapterSpec, CreateFile, EmbeddedModel, EndpointSettings, Family, LoadReport, Loading,
    LocalModel, MemoryCheck, Mllm, MllmError, ModelCheck, ModelOutline, ModelPlace, ModelShape,
    WeightFormat, export_model,
};
use hub::{GgufChoice, HubFiles, HubName, HubPlace};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Finds and opens models.
#[derive(Clone)]
pub struct ModelRegistry {
    /// The folder of descriptions.
    models: PathBuf,
    hub: HubAccess,
    loading: Loading,
    trust: Trust,
    listener: Option<Arc<FetchListener>>,
}

impl fmt::Debug for ModelRegistry {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            models,
            hub,
            loading,
            ..
        } = self;
        out.debug_struct("ModelRegistry")
            .field("models", models)
            .field("hub", hub)
            .field("loading", loading)
            .finish_non_exhaustive()
    }
}

#[cfg(feature = "endpoint")]
fn connect(name: &str, settings: &EndpointSettings) -> Result<Box<dyn Mllm>, MllmError> {
    Ok(Box::new(super::Endpoint::open(name, settings)?))
}

#[cfg(not(feature = "endpoint"))]
fn connect(_: &str, settings: &EndpointSettings) -> Result<Box<dyn Mllm>, MllmError> {
    let problem = format!(
        "this build cannot ask {}; build with the cargo feature `endpoint`",
        settings.endpoint
    );
    Err(MllmError::Request { problem })
}

fn no_files(spec: &ModelSpec, settings: &EndpointSettings) -> MllmError {
    MllmError::NoFiles {
        name: spec.name.clone(),
        endpoint: settings.endpoint.clone(),
    }
}

/// Does work on a model's files. A panic, for example of the library that runs tokenizers, becomes
/// an error.
fn without_panic<T>(
    place: &ModelPlace,
    work: impl FnOnce() -> Result<T, MllmError>,
) -> Result<T, MllmError> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).unwrap_or_else(|payload| {
        let text = payload.downcast_ref::<&str>().map(ToString::to_string);
        let message = text
            .or_else(|| payload.downcast_ref::<String>().cloned())
            .unwrap_or_else(|| "no message".to_owned());
        Err(MllmError::Panicked {
            place: place.path().to_path_buf(),
            message,
        })
    })
}

impl ModelRegistry {
    /// A registry of the descriptions `models/*.toml`.
    pub fn new(models: impl Into<PathBuf>, hub: HubAccess) -> Self {
        Self {
            models: models.into(),
            hub,
            loading: Loading::default(),
            trust: Trust::default(),
            listener: None,
        }
    }

    /// Sets the format of weights in memory; `None` keeps that of the description, else of the
    /// files.
    pub fn with_quantize(mut self, quantize: Option<WeightFormat>) -> Self {
        self.loading.quantize = quantize;
        self
    }

    /// Sets what is merged into the weights; `None` keeps the adapter of the description.
    pub fn with_adapter(mut self, adapter: Option<AdapterSpec>) -> Self {
        self.loading.adapter = adapter;
        self
    }

    /// The registry for a draft model, which has no adapter.
    fn of_drafts(&self) -> Self {
        self.clone().with_adapter(None)
    }

    /// What is merged into the weights of a model.
    fn adapter(&self, spec: &ModelSpec) -> Option<AdapterSpec> {
        self.loading
            .adapter
            .clone()
            .or_else(|| spec.adapter.clone())
    }

    /// Sets the longest chat, tokens; `None` for that of the model.
    pub fn with_context(mut self, context: Option<usize>) -> Self {
        self.loading.context = context;
        self
    }

    /// Sets what to do with a model that needs more memory than is free.
    pub fn with_memory_check(mut self, memory: MemoryCheck) -> Self {
        self.loading.memory = memory;
        self
    }

    /// Sets why chat templates and tokenizers of files may be opened. By default nobody vouches for
    /// them.
    pub fn with_trust(mut self, trust: Trust) -> Self {
        self.trust = trust;
        self
    }

    pub fn with_family(mut self, family: &'static Family) -> Self {
        self.loading.families = self.loading.families.with(family);
        self
    }

    /// Sets the listener for the progress of downloads. It must not block.
    pub fn with_listener(mut self, listener: Arc<FetchListener>) -> Self {
        self.listener = Some(listener);
        self
    }

    /// Where a model's files are; a hub model is downloaded if it is missing and downloads are
    /// allowed.
    pub fn place(&self, spec: &ModelSpec) -> Result<ModelPlace, MllmError> {
        self.place_by(&self.hub, spec)
    }

    /// As [`Self::place`], and downloads the tokenizer and the draft model too.
    pub fn fetch(&self, spec: &ModelSpec) -> Result<ModelPlace, MllmError> {
        self.loading(spec)?;
        spec.draft().map(|draft| self.place(&draft)).transpose()?;
        self.place(spec)
    }

    /// Where a model's files are on this machine.
    pub fn place_here(&self, spec: &ModelSpec) -> Result<ModelPlace, MllmError> {
        self.place_by(
            &HubAccess {
                offline: true,
                ..self.hub.clone()
            },
            spec,
        )
    }

    fn place_by(&self, hub: &HubAccess, spec: &ModelSpec) -> Result<ModelPlace, MllmError> {
        let place = self.whole_place(hub, spec)?;
        if spec.vision {
            Ok(place)
        } else {
            place.decoder_alone()
        }
    }

    fn whole_place(&self, hub: &HubAccess, spec: &ModelSpec) -> Result<ModelPlace, MllmError> {
        // One match: an arm is a kind of source in a description.
        Ok(match &spec.source {
            ModelSource::Endpoint(settings) => return Err(no_files(spec, settings)),
            ModelSource::Folder { folder } => ModelPlace::Folder(folder.clone()),
            ModelSource::Embedded { embedded } => ModelPlace::Embedded(
                EmbeddedModel::find(embedded).ok_or_else(|| self.unknown(embedded))?,
            ),
            ModelSource::File { file, mmproj } => ModelPlace::Gguf {
                model: file.clone(),
                mmproj: mmproj.clone(),
            },
            ModelSource::Hub {
                hub: id,
                revision,
                file,
                quant,
                mmproj,
            } => {
                let name = HubName {
                    id: id.clone(),
                    revision: Some(revision.clone())
                        .filter(|revision| *revision != model_source::default_revision()),
                    file: file.clone(),
                    quant: quant.clone(),
                };
                let model = file.clone().map(GgufChoice::File);
                let model = model.or_else(|| quant.clone().map(GgufChoice::Quant));
                let files = match model {
                    None => HubFiles::Model {
                        tokenizer: spec.tokenizer.is_none(),
                    },
                    Some(model) => HubFiles::Gguf {
                        model,
                        mmproj: mmproj.clone(),
                    },
                };
                match self.snapshot(hub, &name, &files)? {
                    HubPlace { folder, gguf: None } => ModelPlace::Folder(folder),
                    HubPlace {
                        folder,
                        gguf: Some(names),
                    } => ModelPlace::Gguf {
                        model: folder.join(names.model),
                        mmproj: names.mmproj.map(|name| folder.join(name)),
                    },
                }
            }
        })
    }

    fn snapshot(
        &self,
        hub: &HubAccess,
        name: &HubName,
        files: &HubFiles,
    ) -> Result<HubPlace, MllmError> {
        hub.fetch(name, files, self.listener.clone())
    }

    /// How a model is asked: as its description says, else its own files, else with the paper's
    /// prompts. A hub model without a description is downloaded if it is missing and downloads are
    /// allowed.
    pub fn asking(&self, spec: &ModelSpec) -> Result<Asking, MllmError> {
        match &spec.prompt_set {
            Some(prompts) => Ok(Asking {
                prompt_set: prompts.opened_by(),
                named_by: NamedBy::Description,
                generation: spec.generation,
            }),
            // A server has no files that could say it.
            None if matches!(spec.source, ModelSource::Endpoint(_)) => Ok(Asking::plain()),
            None => Asking::of_files(&self.place(spec)?),
        }
    }

    /// As [`Self::asking`], without a download.
    pub fn asking_here(&self, spec: &ModelSpec) -> Result<Asking, MllmError> {
        let hub = HubAccess {
            offline: true,
            ..self.hub.clone()
        };
        Self {
            hub,
            ..self.clone()
        }
        .asking(spec)
    }

    /// Opens a model, or a connection to the server that computes it.
    ///
    /// # Errors
    /// When its files are missing or broken, have another architecture than its description, or
    /// need more memory than is free. When nobody vouches for them, or they failed their trial.
    /// When a server's key is missing, or the server is remote and the network is off.
    pub fn open(&self, spec: &ModelSpec) -> Result<Box<dyn Mllm>, MllmError> {
        if let ModelSource::Endpoint(settings) = &spec.source {
            if self.hub.offline && !settings.is_local() {
                return Err(MllmError::Offline {
                    endpoint: settings.endpoint.clone(),
                    variable: offline_variable(),
                });
            }
            return connect(&spec.name, settings);
        }
        let place = self.place(spec)?;
        let loading = Loading {
            thinking: self.asking(spec)?.generation.thinking,
            ..self.loading(spec)?
        };
        self.admit(spec, &place, &loading)?;
        let model = without_panic(&place, || LocalModel::load(&spec.name, &place, &loading))?;
        let Some(draft) = spec.draft() else {
            return Ok(Box::new(model));
        };
        let (place, loading) = (self.place(&draft)?, self.of_drafts().loading(&draft)?);
        self.admit(&draft, &place, &loading)?;
        Ok(Box::new(without_panic(&place, || {
            model.with_draft_model(&place, &loading)
        })?))
    }

    /// Whether the chat template and the tokenizer of a model may be opened in this process.
    fn admit(
        &self,
        spec: &ModelSpec,
        place: &ModelPlace,
        loading: &Loading,
    ) -> Result<(), MllmError> {
        if spec.trusted {
            Ok(())
        } else {
            self.trust.admit(place, loading)
        }
    }

    /// Checks a model's files on this machine without reading its weights.
    pub fn check(&self, spec: &ModelSpec) -> Result<ModelCheck, MllmError> {
        let (place, loading) = (self.place_here(spec)?, self.loading(spec)?);
        let unopened = match self.admit(spec, &place, &loading) {
            Ok(()) => None,
            // The check names all errors, and not the first one alone.
            Err(MllmError::Unopened { problem }) => Some(problem),
            Err(error) => return Ok(ModelCheck::refused(&place, &error)),
        };
        let checked = without_panic(&place, || Ok(LocalModel::check(&place, &loading)));
        let mut check = checked.unwrap_or_else(|error| ModelCheck::refused(&place, &error));
        if check.problems.is_empty() {
            check.problems.extend(unopened);
        }
        if let Some(draft) = spec.draft() {
            let mut problems = match self.of_drafts().check(&draft) {
                Ok(checked) => checked.problems,
                Err(error) => vec![error.to_string()],
            };
            if problems.is_empty() && check.problems.is_empty() {
                let (drafts, how) = (self.place_here(&draft)?, self.of_drafts().loading(&draft)?);
                let fits = without_panic(&drafts, || {
                    LocalModel::check_draft([&place, &drafts], [&loading, &how])
                });
                problems.extend(fits.err().map(|error| error.to_string()));
            }
            check.problems.extend(
                problems
                    .into_iter()
                    .map(|problem| format!("draft_model: {problem}")),
            );
        }
        Ok(check)
    }

    /// What a model is and needs, by the headers of its files on this machine, else by the known
    /// shape of the repository that it comes from.
    pub fn outline(&self, spec: &ModelSpec) -> Result<ModelOutline, MllmError> {
        let families = &self.loading.families;
        let here = self
            .place_here(spec)
            .and_then(|place| Checkpoint::open(&place, None, families))
            .and_then(|checkpoint| checkpoint.adapted(self.adapter(spec).as_ref()));
        let checkpoint = match (here, &spec.source) {
            (
                Err(error),
                ModelSource::Hub {
                    hub,
                    file: None,
                    quant: None,
                    ..
                },
            ) => ModelShape::of_hub(hub).ok_or(error)?.checkpoint(families)?,
            (here, _) => here?,
        };
        ModelOutline::from_checkpoint(checkpoint, spec.image)
    }

    /// Writes a model as GGUF with weights in `weight_format`, and how it is asked; [`GgufPart`]
    /// lists the files. `progress` gets the bytes that are written so far, and all bytes.
    pub fn export(
        &self,
        spec: &ModelSpec,
        weight_format: WeightFormat,
        create: &mut CreateFile<'_>,
        progress: &mut dyn FnMut(u64, u64),
    ) -> Result<LoadReport, MllmError> {
        let place = self.place(spec)?;
        self.admit(spec, &place, &self.loading(spec)?)?;
        let loading = Loading {
            quantize: Some(weight_format),
            ..self.loading(spec)?
        };
        let added = [self.asking(spec)?.to_file()];
        export_model(&spec.name, &place, &loading, &added, create, progress)
    }

    /// The settings for a model without a description and an adapter.
    pub fn plain_loading(&self) -> Loading {
        self.of_drafts().loading
    }

    /// The settings for a described model.
    pub fn loading(&self, spec: &ModelSpec) -> Result<Loading, MllmError> {
        let tokenizer = match &spec.tokenizer {
            None => None,
            Some(ModelSource::Endpoint(settings)) => return Err(no_files(spec, settings)),
            // An embedded model reads its own tokenizer only.
            Some(ModelSource::Embedded { embedded }) => return Err(self.unknown(embedded)),
            Some(ModelSource::Folder { folder }) => Some(folder.clone()),
            Some(ModelSource::File { file, .. }) => file.parent().map(Path::to_path_buf),
            Some(ModelSource::Hub { hub, revision, .. }) => {
                let name = HubName {
                    id: hub.clone(),
                    revision: Some(revision.clone()),
                    ..HubName::default()
                };
                Some(
                    self.snapshot(&self.hub, &name, &HubFiles::Tokenizer)?
                        .folder,
                )
            }
        };
        let expected = spec
            .architecture
            .map(|architecture| (architecture, spec.name.clone()));
        let (quantize, families) = (
            self.loading.quantize.or(spec.quantize),
            self.loading.families.clone(),
        );
        Ok(Loading {
            quantize,
            adapter: self.adapter(spec),
            tokenizer,
            expected,
            families,
            image: spec.image,
            thinking: spec.generation.thinking,
            ..self.loading.clone()
        })
    }
}

#[cfg(test)]
mod tests;
