//! Which source file imports from which: the paths of `use` declarations, and `crate::` and
//! `super::` paths in code.
//!
//! A name that a module re-exports leads to the file that defines it, so the `mod.rs` of a folder
//! counts only where its own code is used.

use std::collections::{BTreeMap, BTreeSet};

/// A `use` declaration of one name.
struct Import {
    /// The name in this file; `*` for a glob.
    name: String,
    path: Vec<String>,
    /// Whether it passes the name on.
    reexport: bool,
}

/// A source file without its tests.
struct Module {
    file: String,
    imports: Vec<Import>,
    /// `crate::` and `super::` paths outside of `use` declarations.
    inline: Vec<Vec<String>>,
    /// The code without `use` declarations.
    code: String,
}

/// The imports of all files, by index.
pub(super) struct Graph {
    pub(super) files: Vec<String>,
    edges: Vec<BTreeSet<usize>>,
}

impl Graph {
    /// Reads the imports of files: path from the package's root, and the code without comments and
    /// tests.
    pub(super) fn from_sources(sources: &[(String, String)]) -> Self {
        let modules: Vec<Module> = sources
            .iter()
            .map(|(file, code)| Module::parse(file, code))
            .collect();
        let by_path: BTreeMap<Vec<String>, usize> = modules
            .iter()
            .enumerate()
            .map(|(index, module)| (module_path(&module.file), index))
            .collect();
        let edges = modules
            .iter()
            .enumerate()
            .map(|(index, module)| {
                let own = module_path(&module.file);
                let used = module
                    .imports
                    .iter()
                    .filter(|import| !import.reexport || module.mentions(&import.name));
                used.map(|import| &import.path)
                    .chain(&module.inline)
                    .flat_map(|path| resolve(&modules, &by_path, &own, path, 0))
                    .filter(|target| *target != index)
                    .collect()
            })
            .collect();
        Self {
            files: sources.iter().map(|(file, _)| file.clone()).collect(),
            edges,
        }
    }

    /// All imports: the file that uses, and the file that is used.
    pub(super) fn imports(&self) -> impl Iterator<Item = (&str, &str)> {
        let name = |index: usize| self.files[index].as_str();
        self.edges
            .iter()
            .enumerate()
            .flat_map(move |(from, to)| to.iter().map(move |to| (name(from), name(*to))))
    }

    /// Groups of files that import each other, directly or through others, largest first.
    pub(super) fn circles(&self) -> Vec<Vec<&str>> {
        let reachable: Vec<BTreeSet<usize>> = (0..self.files.len())
            .map(|start| self.reachable(start))
            .collect();
        let mut circles: Vec<Vec<&str>> = Vec::new();
        let mut seen: BTreeSet<usize> = BTreeSet::new();
        for start in 0..self.files.len() {
            if seen.contains(&start) || !reachable[start].contains(&start) {
                continue;
            }
            let circle: Vec<usize> = reachable[start]
                .iter()
                .copied()
                .filter(|other| reachable[*other].contains(&start))
                .collect();
            seen.extend(&circle);
            circles.push(
                circle
                    .into_iter()
                    .map(|index| self.files[index].as_str())
                    .collect(),
            );
        }
        circles.sort_by_key(|circle| std::cmp::Reverse(circle.len()));
        circles
    }

    fn reachable(&self, start: usize) -> BTreeSet<usize> {
        let mut found = BTreeSet::new();
        let mut open = vec![start];
        while let Some(file) = open.pop() {
            open.extend(self.edges[file].iter().filter(|next| found.insert(**next)));
        }
        found
    }
}

impl Module {
    fn parse(file: &str, source: &str) -> Self {
        let mut module = Self {
            file: file.into(),
            imports: Vec::new(),
            inline: Vec::new(),
            code: String::new(),
        };
        let mut lines = source.lines();
        while let Some(line) = lines.next() {
            let Some(start) = use_start(line) else {
                // A module may have the name of a function that is re-exported from it.
                let declares_module =
                    line.ends_with(';') && line.split_whitespace().any(|word| word == "mod");
                if !declares_module {
                    module.code += line;
                    module.code.push('\n');
                }
                continue;
            };
            let mut text = line.trim()[start..].to_string();
            while !text.contains(';') {
                text.push_str(lines.next().unwrap_or(";"));
            }
            let reexport = line.trim_start().starts_with("pub");
            for path in expand(text.trim_end_matches(';').trim()) {
                let (path, name) = match path.split_once(" as ") {
                    Some((path, name)) => (path.to_string(), Some(name.trim().to_string())),
                    None => (path, None),
                };
                let mut path: Vec<String> = path
                    .split("::")
                    .map(|part| part.trim().to_string())
                    .collect();
                if path.last().is_some_and(|last| last == "self") {
                    path.pop();
                }
                let name = name.unwrap_or_else(|| path.last().cloned().unwrap_or_default());
                module.imports.push(Import {
                    name,
                    path,
                    reexport,
                });
            }
        }
        for start in ["crate::", "super::"] {
            for (at, _) in module.code.match_indices(start) {
                // The middle of a path was seen from its beginning; `pub(in path)` uses nothing.
                let before = &module.code[..at];
                if !before.ends_with("::")
                    && !before.ends_with("(in ")
                    && !before.ends_with(char::is_alphanumeric)
                {
                    let path = module.code[at..]
                        .split(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':'));
                    let path = path
                        .into_iter()
                        .next()
                        .unwrap_or_default()
                        .trim_end_matches(':');
                    module
                        .inline
                        .push(path.split("::").map(str::to_string).collect());
                }
            }
        }
        module
    }

    /// Whether the code outside of `use` declarations has this word.
    fn mentions(&self, name: &str) -> bool {
        let is_word = |c: char| c.is_alphanumeric() || c == '_';
        self.code.match_indices(name).any(|(at, _)| {
            !self.code[..at].ends_with(is_word)
                && !self.code[at + name.len()..].starts_with(is_word)
        })
    }
}

/// Where the path of a `use` declaration starts in the trimmed line.
fn use_start(line: &str) -> Option<usize> {
    let line = line.trim();
    let rest = match line.strip_prefix("pub(") {
        Some(rest) => rest.split_once(')')?.1.trim_start(),
        None => line.strip_prefix("pub ").unwrap_or(line),
    };
    let path = rest.strip_prefix("use ")?;
    Some(line.len() - path.len())
}

/// The paths of a `use` tree, braces taken apart.
fn expand(tree: &str) -> Vec<String> {
    let tree = tree.trim();
    let Some((prefix, rest)) = tree.split_once('{') else {
        return if tree.is_empty() {
            Vec::new()
        } else {
            vec![tree.to_string()]
        };
    };
    let inside = rest.strip_suffix('}').unwrap_or(rest);
    let (mut depth, mut parts, mut start) = (0, Vec::new(), 0);
    for (at, character) in inside.char_indices() {
        match character {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                parts.push(&inside[start..at]);
                start = at + 1;
            }
            _ => {}
        }
    }
    parts.push(&inside[start..]);
    parts
        .into_iter()
        .flat_map(expand)
        .map(|part| format!("{prefix}{part}"))
        .collect()
}

/// `src/a/b.rs` and `src/a/b/mod.rs` are both `a::b`.
fn module_path(file: &str) -> Vec<String> {
    let path = file.trim_start_matches("src/").trim_end_matches(".rs");
    let mut parts: Vec<String> = path.split('/').map(str::to_string).collect();
    if parts
        .last()
        .is_some_and(|last| ["mod", "lib", "main"].contains(&last.as_str()))
    {
        parts.pop();
    }
    parts
}

/// The files that a path of a module leads to; several behind a glob, none outside of the package.
fn resolve(
    modules: &[Module],
    by_path: &BTreeMap<Vec<String>, usize>,
    own: &[String],
    path: &[String],
    depth: usize,
) -> Vec<usize> {
    /// Re-exports of re-exports; more are a loop.
    const MAX_DEPTH: usize = 8;
    let mut at = own.to_vec();
    let mut rest = path;
    match path.first().map(String::as_str) {
        Some("crate") => {
            at.clear();
            rest = &rest[1..];
        }
        Some("self") => rest = &rest[1..],
        Some("super") => {}
        Some(first) => {
            // A child of this module, or another package.
            let child = [at.as_slice(), &[first.to_string()]].concat();
            let imported = by_path
                .get(&at)
                .and_then(|index| modules[*index].imports.iter().find(|i| i.name == first));
            if !by_path.contains_key(&child) {
                return match imported {
                    Some(import) if import.path != path && depth < MAX_DEPTH => {
                        let path = [import.path.as_slice(), &path[1..]].concat();
                        resolve(modules, by_path, own, &path, depth + 1)
                    }
                    _ => Vec::new(),
                };
            }
        }
        None => return Vec::new(),
    }
    while rest.first().is_some_and(|part| part == "super") {
        at.pop();
        rest = &rest[1..];
    }
    while let Some(next) = rest.first() {
        at.push(next.clone());
        if !by_path.contains_key(&at) {
            at.pop();
            break;
        }
        rest = &rest[1..];
    }
    let Some(index) = by_path.get(&at).copied() else {
        return Vec::new();
    };
    let Some(name) = rest.first() else {
        return vec![index];
    };
    let named = |import: &&Import| name == "*" && import.reexport || import.name == *name;
    let found: Vec<&Import> = modules[index].imports.iter().filter(named).collect();
    if found.is_empty() || depth >= MAX_DEPTH {
        return vec![index];
    }
    found
        .into_iter()
        .flat_map(|import| {
            let path = [
                import.path.as_slice(),
                if name == "*" { &[] } else { &rest[1..] },
            ]
            .concat();
            resolve(modules, by_path, &at, &path, depth + 1)
        })
        .collect()
}

#[test]
fn paths_lead_to_the_file_that_defines_the_name() {
    let sources = [
        (
            "src/a/mod.rs",
            "mod b;\nmod c;\npub(crate) use b::{\n    B, Other as Renamed,\n};\nuse c::C;\n",
        ),
        ("src/a/b.rs", "use super::c::C;\npub struct B;"),
        ("src/a/c.rs", "fn f() { super::own(); }"),
        (
            "src/d.rs",
            "use std::fmt;\nuse crate::a::{self, Renamed};\nfn g() { crate::a::c::C; }",
        ),
        ("src/e.rs", "use crate::a::B;"),
    ]
    .map(|(file, code)| (file.to_string(), code.to_string()));
    let graph = Graph::from_sources(&sources);
    let imports: Vec<_> = graph
        .imports()
        .map(|(from, to)| format!("{} {}", &from[4..], &to[4..]))
        .collect();
    let expected = [
        "a/mod.rs a/c.rs",
        "a/b.rs a/c.rs",
        "a/c.rs a/mod.rs",
        "d.rs a/mod.rs",
        "d.rs a/b.rs",
        "d.rs a/c.rs",
        "e.rs a/b.rs",
    ];
    assert_eq!(imports, expected);
    assert_eq!(graph.circles(), [["src/a/mod.rs", "src/a/c.rs"]]);
}
