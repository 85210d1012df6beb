//! `planagent models quantize`.

use crate::args::QuantizeArguments;
use crate::picture::check_output;
use crate::{Exit, Printer};
use anyhow::{Context, bail};
use planagent_files::WholeFile;
use planagent_mllm::{CreateFile, GgufPart, LoadReport, MllmError, ModelRegistry, in_bytes};
use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Writes a model as GGUF. The files get their names when they are complete.
pub(super) fn run(
    flags: &QuantizeArguments,
    registry: &ModelRegistry,
    printer: Printer,
) -> anyhow::Result<Exit> {
    if flags
        .out
        .extension()
        .is_none_or(|extension| extension != "gguf")
    {
        bail!(
            "--out {}: the name must end in .gguf, or the file is not recognized as a model",
            flags.out.display()
        );
    }
    let parts = [GgufPart::Model, GgufPart::Tower];
    let there = parts
        .map(|part| part.path(&flags.out))
        .into_iter()
        .find(|path| path.exists());
    if let Some(path) = there.filter(|_| !flags.force) {
        bail!("{} exists; --force overwrites it", path.display());
    }
    let spec = registry.find(&flags.source)?;
    // Before the model is read, which may take minutes.
    for part in parts {
        check_output(&part.path(&flags.out))?;
    }
    let (report, files) = write(&flags.out, printer, |create, progress| {
        registry.export(&spec, flags.to, create, progress)
    })
    .with_context(|| {
        format!(
            "cannot write the model '{}' to {}",
            spec.name,
            flags.out.display()
        )
    })?;
    if printer.is_json() {
        let files: Vec<_> = files
            .iter()
            .map(
                |(bytes, path)| serde_json::json!({"path": path.to_string_lossy(), "bytes": bytes}),
            )
            .collect();
        printer
            .json(&serde_json::json!({"model": flags.source, "files": files, "load": report}))?;
    } else {
        report.lines().iter().for_each(|line| printer.line(line));
        for (bytes, path) in &files {
            printer.line(format!("{}: {}", path.display(), in_bytes(*bytes)));
        }
    }
    Ok(Exit::Success)
}

/// Writes a model's GGUF files with a bar, and gives the report of the tensors and each file with
/// its length. The files get their names when they are complete; a failure leaves none behind.
pub(crate) fn write(
    out: &Path,
    printer: Printer,
    export: impl FnOnce(&mut CreateFile<'_>, &mut dyn FnMut(u64, u64)) -> Result<LoadReport, MllmError>,
) -> anyhow::Result<(LoadReport, Vec<(u64, PathBuf)>)> {
    let bar = printer.byte_progress(0);
    let mut written = Vec::new();
    let mut create = |part: GgufPart| -> io::Result<Box<dyn Write>> {
        let file = WholeFile::create(&part.path(out))?;
        let writer = file.writer()?;
        written.push((part, file));
        Ok(Box::new(BufWriter::with_capacity(1 << 20, writer)))
    };
    let exported = export(&mut create, &mut |bytes, total| {
        bar.set_length(total);
        bar.set_position(bytes);
    });
    bar.finish_and_clear();
    let report = exported?;
    let mut files = Vec::new();
    for (part, file) in written {
        let path = part.path(out);
        file.finish()
            .with_context(|| format!("cannot write {}", path.display()))?;
        files.push((fs::metadata(&path)?.len(), path));
    }
    Ok((report, files))
}
