//! Links and paths of the pages lead to something.

use super::text::{anchors, links, without_blocks};
use super::{docs, markdown, name, read, root};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// All pages that a reader of the project opens.
fn pages() -> Vec<PathBuf> {
    let mut pages = markdown(root());
    pages.extend(docs());
    pages.push(root().join("docs/README.md"));
    pages.extend(markdown(&root().join("docs/decisions")));
    pages.extend(markdown(&root().join("models/nano")));
    pages
}

#[test]
fn every_relative_link_and_anchor_exists() {
    let mut wrong = Vec::new();
    let mut checked = 0;
    for page in pages() {
        let text = read(&page);
        for (line, target) in links(&text) {
            if target.contains("://") {
                continue;
            }
            checked += 1;
            let (path, anchor) = target
                .split_once('#')
                .map_or((target.as_str(), None), |(path, anchor)| {
                    (path, Some(anchor))
                });
            let file = if path.is_empty() {
                page.clone()
            } else {
                page.parent().unwrap().join(path)
            };
            if !file.exists() {
                wrong.push(format!("{}:{line}: no {target}", name(&page)));
            } else if let Some(anchor) = anchor
                && !anchors(&read(&file)).iter().any(|known| known == anchor)
            {
                wrong.push(format!("{}:{line}: no heading for {target}", name(&page)));
            }
        }
    }
    assert!(
        checked > 50 && wrong.is_empty(),
        "{checked} links\n{}",
        wrong.join("\n")
    );
}

/// Words between backticks outside of blocks, with page and line.
fn code_words() -> Vec<(String, String)> {
    let mut found = Vec::new();
    for page in pages()
        .iter()
        .filter(|page| !page.ends_with("CHANGELOG.md"))
    {
        for (i, line) in without_blocks(&read(page)).lines().enumerate() {
            let words = line.split('`').skip(1).step_by(2);
            let place = format!("{}:{}", name(page), i + 1);
            found.extend(words.map(|word| (place.clone(), word.to_owned())));
        }
    }
    found
}

/// The sources, tests and examples that pages name between backticks.
#[test]
fn every_named_source_exists() {
    let folders = [
        "src/",
        "tests/",
        "examples/",
        "studies/",
        "suites/",
        "prompts/",
        "benches/",
    ];
    let mut wrong = Vec::new();
    for (place, word) in code_words() {
        let path = word.split("::").next().unwrap_or_default();
        let is_path = folders.iter().any(|folder| path.starts_with(folder));
        let is_plain = path
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "/_-.".contains(c));
        let is_placeholder = path.contains("NAME");
        if is_path && is_plain && !is_placeholder && !root().join(path).exists() {
            wrong.push(format!("{place}: no {path}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The modules that pages name between backticks, as `kernels::matrix`.
#[test]
fn every_named_module_exists() {
    let modules: Vec<String> = sources(&root().join("src"))
        .iter()
        .map(|file| name(&file.with_extension("")).replace('/', "::"))
        .map(|module| format!("{}::", module.trim_end_matches("::mod")))
        .collect();
    let mut words = code_words();
    words.retain(|(_, word)| {
        let mut chars = word.chars();
        word.contains("::") && chars.all(|c| c.is_ascii_lowercase() || c == '_' || c == ':')
    });
    let exists = |word: &str| {
        let part = format!("::{word}::");
        modules.iter().any(|module| module.contains(&part))
    };
    let wrong: Vec<_> = words.iter().filter(|(_, word)| !exists(word)).collect();
    assert!(words.len() > 3 && wrong.is_empty(), "{wrong:?}");
}

/// The decisions that comments of the sources name, and those that no comment names.
#[test]
fn sources_name_decisions_that_exist_and_every_research_decision_is_named() {
    let mut named = BTreeSet::new();
    let files = ["src", "python/src"].map(|folder| sources(&root().join(folder)));
    for file in files.concat() {
        for (i, line) in read(&file).lines().enumerate() {
            for word in line.split("docs/decisions/").skip(1) {
                let page = word.split_inclusive(".md").next().unwrap_or_default();
                let path = root().join("docs/decisions").join(page);
                assert!(path.is_file(), "{}:{}: no {page}", name(&file), i + 1);
                named.insert(page.to_owned());
            }
        }
    }
    // It explains the format of a dataset, and no constant or setting.
    let of_no_source = ["125-"];
    for page in markdown(&root().join("docs/decisions")) {
        let page = page.file_name().unwrap().to_str().unwrap().to_owned();
        let needs_name =
            page.starts_with('1') && !of_no_source.iter().any(|number| page.starts_with(number));
        assert!(
            !needs_name || named.contains(&page),
            "no source names docs/decisions/{page}"
        );
    }
}

/// The Rust files below a folder.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(sources(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
    found
}

#[test]
fn the_index_has_every_page() {
    let index = read(&root().join("docs/README.md"));
    let targets: Vec<String> = links(&index)
        .into_iter()
        .map(|(_, target)| target)
        .collect();
    for page in docs() {
        let file = page.file_name().unwrap().to_string_lossy().into_owned();
        assert!(targets.contains(&file), "docs/README.md lacks {file}");
    }
}
