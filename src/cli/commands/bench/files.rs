//! The files that both engines of a comparison read.

use crate::Printer;
use crate::commands::models::quantize::write as write_gguf;
use anyhow::{Context, bail};
use planagent_lab::bench::protocol::{
    ExportedFolder, GgufPair, ModelChoice, Precision, PrepareRequest,
};
use planagent_lab::bench::{Candidate, PythonWorker};
use planagent_mllm::{
    GgufPart, Loading, ModelPlace, ModelRegistry, ModelShape, export_model, small_files,
};
use planagent_runs::runner::Config;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Writes the files of candidates for another engine, and finds those that are there.
pub(super) struct OtherFiles<'a> {
    /// The folder of written files.
    pub folder: &'a Path,
    pub config: &'a Config,
    pub registry: &'a ModelRegistry,
    pub printer: Printer,
}

impl OtherFiles<'_> {
    /// A model as GGUF files that llama.cpp reads too: its own, or newly written ones.
    pub(super) fn gguf(&self, candidate: &Candidate) -> anyhow::Result<Candidate> {
        if matches!(candidate.model, ModelChoice::Gguf(_)) {
            return Ok(candidate.clone());
        }
        let (place, loading) = self.place(candidate)?;
        let files = |decoder: PathBuf, projector: Option<PathBuf>| Candidate {
            model: ModelChoice::Gguf(GgufPair { decoder, projector }),
            ..candidate.clone()
        };
        // With a format that is asked for, both engines read a new file in it.
        if self.config.mllm.quantize.is_none()
            && let Some((decoder, projector)) = place.decoder_and_tower()?
        {
            return Ok(files(decoder, projector));
        }
        // Both engines must read the same numbers.
        let Some(weight_format) = self.config.mllm.quantize else {
            bail!(
                "--vs needs --quantize, or a model of GGUF files, because both engines must read the same files"
            );
        };
        let decoder = self.folder.join(format!(
            "{}-{weight_format}-seed-{}.gguf",
            candidate.weights, self.config.seed
        ));
        if !decoder.is_file() {
            self.write_gguf(candidate, &place, &loading, &decoder)?;
        }
        let tower = GgufPart::Tower.path(&decoder);
        let written = ModelPlace::Gguf {
            model: decoder,
            mmproj: tower.is_file().then_some(tower),
        };
        let Some((decoder, projector)) = written.decoder_and_tower()? else {
            bail!(
                "cannot compare {}: this program wrote no pair of llama.cpp's files; name a pair that llama.cpp's converter wrote",
                candidate.name
            );
        };
        Ok(files(decoder, projector))
    }

    fn write_gguf(
        &self,
        candidate: &Candidate,
        place: &ModelPlace,
        loading: &Loading,
        decoder: &Path,
    ) -> anyhow::Result<()> {
        let printer = self.printer;
        printer.note(format!("{}: writing {}", candidate.name, decoder.display()));
        std::fs::create_dir_all(self.folder)
            .with_context(|| format!("cannot create the folder {}", self.folder.display()))?;
        let (report, _) = write_gguf(decoder, printer, |create, progress| {
            export_model(&candidate.weights, place, loading, &[], create, progress)
        })
        .with_context(|| format!("cannot write {} as GGUF", candidate.name))?;
        // The caller may refuse the file, and a note says why it is none of llama.cpp.
        for note in &report.notes {
            printer.note(format!("{}: {note}", candidate.name));
        }
        Ok(())
    }

    /// A model as a folder of safetensors, its own or a newly written one, with its export for
    /// another engine in the precisions of decoder and vision tower.
    pub(super) fn export(
        &self,
        candidate: &Candidate,
        worker: &PythonWorker,
        [weights, tower]: [Precision; 2],
    ) -> anyhow::Result<Candidate> {
        if matches!(candidate.model, ModelChoice::Exported(_)) {
            return Ok(candidate.clone());
        }
        let (place, loading) = self.place(candidate)?;
        let files = place.decoder_and_tower()?;
        let (folder, gguf) = match (&place, files) {
            (_, Some((_, Some(tower)))) => bail!(
                "cannot compare {}: {} is a vision tower in GGUF, which transformers does not read; \
                 name the folder of safetensors that the pair was made of",
                candidate.name,
                tower.display()
            ),
            (_, Some((decoder, None))) => (None, Some(decoder)),
            (ModelPlace::Folder(folder), None) => (Some(folder.clone()), None),
            (ModelPlace::Random { .. }, None) => (None, None),
            (other, None) => bail!(
                "cannot compare {}: {} is a file of this program alone; name the folder of safetensors that it was made of",
                candidate.name,
                other.path().display()
            ),
        };
        let files = match &folder {
            Some(_) => BTreeMap::new(),
            None => small_files(&place, &loading)?,
        };
        let own = format!("{}-seed-{}", candidate.weights, self.config.seed);
        let engine = worker.engine.name;
        let exports = self.folder.join(format!("{own}-{engine}"));
        let exported = ExportedFolder {
            folder: folder.unwrap_or_else(|| self.folder.join(own)),
            export: exports.join(format!("{weights}-{tower}")),
        };
        self.printer.note(format!(
            "{}: {engine} prepares {}",
            candidate.name,
            exported.export.display()
        ));
        let request = PrepareRequest {
            folder: exported.folder.clone(),
            files,
            gguf,
            export: exported.export.clone(),
            weights,
            tower,
            seed: self.config.seed,
        };
        // A process of its own, so that the memory of the export is not that of the measurement.
        worker
            .start()
            .and_then(|mut engine| engine.prepare(request))
            .with_context(|| {
                format!(
                    "cannot compare {} with {engine} of {}; --{engine}-python names another interpreter",
                    candidate.name,
                    worker.python.display()
                )
            })?;
        Ok(Candidate {
            model: ModelChoice::Exported(exported),
            ..candidate.clone()
        })
    }

    /// Where a model is, and how it is loaded.
    fn place(&self, candidate: &Candidate) -> anyhow::Result<(ModelPlace, Loading)> {
        let registry = self.registry;
        let (place, loading) = match &candidate.model {
            ModelChoice::Gguf(_) | ModelChoice::Exported(_) => {
                bail!("the files of {} are prepared already", candidate.name)
            }
            ModelChoice::Named(name) => {
                let spec = registry.find(name)?;
                (registry.place(&spec)?, registry.loading(&spec)?)
            }
            ModelChoice::Random(shape) => (
                ModelPlace::Random {
                    shape: ModelShape::find(shape)?,
                    seed: self.config.seed,
                },
                registry.plain_loading(),
            ),
        };
        if loading.adapter.is_some() {
            bail!(
                "--vs compares files that both engines read; write the merged model with `planagent models quantize --adapter`, \
                 and name that file"
            );
        }
        Ok((place, loading))
    }
}
