//! `manifest.toml` in the folder of a run: read, or known as damaged or of another format.

use super::error::{ReportError, ReportFault};
use super::layout::MANIFEST;
use super::limits::MAX_MANIFEST_BYTES;
use super::manifest::{FORMAT_VERSION, Manifest};
use super::run_files::{RunFiles, read_toml};
use planagent_files::OpenFolder;
use serde::Deserialize;
use std::path::Path;

/// The part of a manifest that every format has.
#[derive(Deserialize)]
struct AnyManifest {
    #[serde(default)]
    format_version: u32,
}

/// The text of a manifest that [`read`] reads again.
pub(super) fn text(place: &Path, manifest: &Manifest) -> Result<Vec<u8>, ReportError> {
    let text = toml::to_string_pretty(manifest).map_err(ReportError::at(place))?;
    if text.len() as u64 > MAX_MANIFEST_BYTES {
        return Err(ReportError::at(place)(ReportFault::LargeManifest {
            bytes: text.len(),
        }));
    }
    Ok(text.into_bytes())
}

/// Fails if a folder holds a run, with what can be done about it. A damaged manifest without
/// simulations is no run: a process that died while it started left it.
pub(super) fn check_holds_no_run(files: &RunFiles) -> Result<(), ReportError> {
    if !files.has(MANIFEST)? {
        return Ok(());
    }
    let fault = match read(files) {
        Ok(_) => ReportFault::AlreadyRun,
        Err(ReportError {
            fault: ReportFault::FormatVersion { found },
            ..
        }) => ReportFault::OldRun { found },
        Err(error) if error.fault.is_damage() && !has_simulations(files) => return Ok(()),
        Err(error) if error.fault.is_damage() => ReportFault::DamagedManifest,
        Err(error) => return Err(error),
    };
    Err(ReportError::at(files.root().path())(fault))
}

/// The manifest of this format version.
pub(super) fn read(files: &RunFiles) -> Result<Manifest, ReportError> {
    let root = files.root();
    let at_root = |fault| ReportError::at(root.path())(fault);
    match read_toml(root, MANIFEST, MAX_MANIFEST_BYTES)? {
        AnyManifest {
            format_version: FORMAT_VERSION,
        } => read_toml(root, MANIFEST, MAX_MANIFEST_BYTES),
        // The first formats had no number.
        AnyManifest { format_version: 0 } if is_blank(root) => {
            Err(at_root(ReportFault::DamagedManifest))
        }
        AnyManifest {
            format_version: found,
        } => Err(at_root(ReportFault::FormatVersion { found })),
    }
}

/// Whether the manifest was cut off before its first line.
fn is_blank(root: &OpenFolder) -> bool {
    root.read_text(MANIFEST, MAX_MANIFEST_BYTES)
        .is_ok_and(|text| text.trim().is_empty())
}

/// Whether a run has simulations, as far as that can be seen.
pub(super) fn has_simulations(files: &RunFiles) -> bool {
    match files.simulations() {
        Ok(None) => false,
        Ok(Some(_)) => files.folders().map_or(true, |found| !found.is_empty()),
        Err(_) => true,
    }
}
