//! README.md and docs: their commands run, their links lead somewhere, their pages have one form.

mod blocks;
mod commands;
mod links;
mod prose;
mod text;

use std::path::{Path, PathBuf};

/// The root of the project.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The pages of docs/, in order, without its index.
fn docs() -> Vec<PathBuf> {
    let mut pages = markdown(&root().join("docs"));
    pages.retain(|page| !page.ends_with("README.md"));
    assert!(pages.len() > 10, "{pages:?}");
    pages
}

/// The Markdown files of a folder, in order.
fn markdown(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> = entries
        .filter(|path| path.extension().is_some_and(|e| e == "md"))
        .collect();
    files.sort();
    files
}

/// Path below the root, for messages.
fn name(page: &Path) -> String {
    page.strip_prefix(root())
        .unwrap()
        .to_string_lossy()
        .into_owned()
}

fn read(page: &Path) -> String {
    std::fs::read_to_string(page).unwrap_or_else(|error| panic!("{}: {error}", page.display()))
}
