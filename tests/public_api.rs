//! The public API as text: a change of it shows in the diff of `tests/golden/public_api.txt`.
//!
//! The names come from `src/lib.rs`, their declarations from the stage or crate that each is
//! re-exported from. What `doc(hidden)` marks is public for the crates of this workspace alone, and
//! no part of it.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use syn::{Attribute, File, ImplItem, Item, ItemImpl, TraitItem, Type, UseTree, Visibility};

/// Set, this variable has the snapshot written.
const UPDATE: &str = "PLANAGENT_UPDATE_GOLDEN";
/// Stages in the folder of a crate that has names of its own at its root.
const STAGES: [&str; 2] = ["dynamics", "geometry"];
/// Names at the crate root, and names in its modules.
const MAX_NAMES: (usize, usize) = (25, 100);

/// A re-exported name with the stage that declares it.
struct Export {
    name: String,
    stage: String,
    declared: String,
}

fn is_public(visibility: &Visibility) -> bool {
    matches!(visibility, Visibility::Public(_))
}

/// Whether an attribute holds a word, such as `hidden` or `test`.
fn says(attributes: &[Attribute], path: &str, word: &str) -> bool {
    let list = |attribute: &Attribute| match &attribute.meta {
        syn::Meta::List(list) if list.path.is_ident(path) => {
            list.tokens.to_string().split(' ').any(|w| w == word)
        }
        _ => false,
    };
    attributes.iter().any(list)
}

fn flatten(tree: &UseTree, path: &[String], found: &mut Vec<Export>) {
    let mut export = |declared: String, name: String| {
        // A module of a crate of several stages is a stage; what stands at a crate's root has the
        // crate for one.
        let stage = if path[0] == "crate" {
            &path[1]
        } else {
            path.last().unwrap()
        };
        let stage = stage.strip_prefix("planagent_").unwrap_or(stage).to_owned();
        found.push(Export {
            name,
            stage,
            declared,
        });
    };
    match tree {
        UseTree::Path(inner) => flatten(
            &inner.tree,
            &[path, &[inner.ident.to_string()]].concat(),
            found,
        ),
        UseTree::Group(group) => group
            .items
            .iter()
            .for_each(|tree| flatten(tree, path, found)),
        UseTree::Name(name) => export(name.ident.to_string(), name.ident.to_string()),
        UseTree::Rename(rename) => export(rename.ident.to_string(), rename.rename.to_string()),
        UseTree::Glob(_) => panic!("the crate root re-exports by name"),
    }
}

fn exports(items: &[Item]) -> Vec<Export> {
    let mut found = Vec::new();
    for item in items {
        if let Item::Use(used) = item
            && is_public(&used.vis)
        {
            flatten(&used.tree, &[], &mut found);
        }
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    found
}

/// The parsed files of each stage.
type Stages = BTreeMap<String, Vec<File>>;

fn stages(root: &Path, names: &[&Export]) -> Stages {
    let mut stages = Stages::new();
    for name in names
        .iter()
        .map(|export| export.stage.as_str())
        .chain(["api"])
    {
        stages.entry(name.to_owned()).or_insert_with(|| {
            let mut files = Vec::new();
            let folders = [Some(root.join("src").join(name)), inner_stage(root, name)];
            let folder = folders
                .into_iter()
                .flatten()
                .find(|folder| folder.exists())
                .unwrap();
            sources(&folder, &mut files);
            files
        });
    }
    stages
}

/// The folder of a stage inside the crate that it shares with others.
fn inner_stage(root: &Path, name: &str) -> Option<PathBuf> {
    let crates = fs::read_dir(root.join("src"))
        .unwrap()
        .map(|entry| entry.unwrap().path());
    crates
        .filter(|folder| folder.join("lib.rs").exists())
        .map(|folder| folder.join(name))
        .find(|stage| stage.exists())
}

fn is_hidden(attributes: &[Attribute]) -> bool {
    says(attributes, "doc", "hidden")
}

/// The parsed files of a stage; those of stages below it in the same crate are not its own.
fn sources(folder: &Path, found: &mut Vec<File>) {
    let is_crate = folder.join("lib.rs").exists();
    let is_stage = |inner: &Path| is_crate && STAGES.iter().any(|stage| inner.ends_with(stage));
    let mut entries: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            if !is_stage(&path) {
                sources(&path, found);
            }
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(syn::parse_file(&fs::read_to_string(path).unwrap()).unwrap());
        }
    }
}

/// Keeps the attributes that a caller feels.
fn trim(attributes: &mut Vec<Attribute>) {
    attributes.retain(|attribute| {
        ["non_exhaustive", "derive", "must_use"]
            .iter()
            .any(|kept| attribute.path().is_ident(kept))
    });
}

fn public_fields(fields: &mut syn::Fields, all: bool) {
    let keep = |field: &syn::Field| all || is_public(&field.vis) && !is_hidden(&field.attrs);
    let trimmed = |mut field: syn::Field| {
        trim(&mut field.attrs);
        field
    };
    match fields {
        syn::Fields::Named(named) => {
            named.named = std::mem::take(&mut named.named)
                .into_iter()
                .filter(keep)
                .map(trimmed)
                .collect();
        }
        syn::Fields::Unnamed(unnamed) => {
            unnamed.unnamed = std::mem::take(&mut unnamed.unnamed)
                .into_iter()
                .filter(keep)
                .map(trimmed)
                .collect();
        }
        syn::Fields::Unit => {}
    }
}

/// The declaration without bodies and private parts, if the item is a public one of this name.
fn declaration(item: &Item, name: &str) -> Option<Item> {
    let mut item = item.clone();
    let named = |ident: &syn::Ident, visibility: &Visibility| {
        (ident == name && is_public(visibility)).then_some(())
    };
    match &mut item {
        Item::Struct(it) => {
            named(&it.ident, &it.vis)?;
            trim(&mut it.attrs);
            public_fields(&mut it.fields, false);
        }
        Item::Enum(it) => {
            named(&it.ident, &it.vis)?;
            trim(&mut it.attrs);
            for variant in &mut it.variants {
                trim(&mut variant.attrs);
                public_fields(&mut variant.fields, true);
            }
        }
        Item::Trait(it) => {
            named(&it.ident, &it.vis)?;
            trim(&mut it.attrs);
            for inner in &mut it.items {
                if let TraitItem::Fn(method) = inner {
                    trim(&mut method.attrs);
                    method.default = method.default.is_some().then(|| syn::parse_quote!({}));
                }
            }
        }
        Item::Fn(it) => {
            named(&it.sig.ident, &it.vis)?;
            trim(&mut it.attrs);
            it.block = syn::parse_quote!({});
        }
        Item::Const(it) => {
            named(&it.ident, &it.vis)?;
            trim(&mut it.attrs);
            it.expr = syn::parse_quote!(_);
        }
        Item::Type(it) => {
            named(&it.ident, &it.vis)?;
            trim(&mut it.attrs);
        }
        _ => return None,
    }
    Some(item)
}

/// The public part of an `impl` of a type: its public functions, or the head of a trait's.
fn implementation(item: &ItemImpl, name: &str) -> Option<Item> {
    let Type::Path(own) = &*item.self_ty else {
        return None;
    };
    let own = own
        .path
        .segments
        .last()
        .is_some_and(|segment| segment.ident == name);
    if !own || says(&item.attrs, "cfg", "test") || is_hidden(&item.attrs) {
        return None;
    }
    let mut item = item.clone();
    item.attrs.clear();
    if item.trait_.is_some() {
        item.items.clear();
        return Some(Item::Impl(item));
    }
    item.items.retain(|inner| match inner {
        ImplItem::Fn(method) => is_public(&method.vis) && !is_hidden(&method.attrs),
        ImplItem::Const(constant) => is_public(&constant.vis) && !is_hidden(&constant.attrs),
        _ => false,
    });
    for inner in &mut item.items {
        match inner {
            ImplItem::Fn(method) => {
                trim(&mut method.attrs);
                method.block = syn::parse_quote!({});
            }
            ImplItem::Const(constant) => {
                trim(&mut constant.attrs);
                constant.expr = syn::parse_quote!(_);
            }
            _ => {}
        }
    }
    (!item.items.is_empty()).then_some(Item::Impl(item))
}

fn describe(export: &Export, stages: &Stages, text: &mut String) {
    let other = if export.stage == "api" {
        None
    } else {
        stages.get("api")
    };
    let files = [stages.get(&export.stage), other]
        .into_iter()
        .flatten()
        .flatten();
    let items: Vec<&Item> = files.flat_map(|file| &file.items).collect();
    let mut found: Vec<Item> = items
        .iter()
        .filter_map(|item| declaration(item, &export.declared))
        .collect();
    if found.is_empty() {
        writeln!(
            text,
            "// {}: declared by a macro of the stage `{}`\n",
            export.declared, export.stage
        )
        .unwrap();
        return;
    }
    let impls = items.iter().filter_map(|item| match item {
        Item::Impl(item) => implementation(item, &export.declared),
        _ => None,
    });
    found.extend(impls);
    if export.name != export.declared {
        writeln!(text, "// {} is", export.name).unwrap();
    }
    text.push_str(&prettyplease::unparse(&File {
        shebang: None,
        frontmatter: None,
        attrs: vec![],
        items: found,
    }));
    text.push('\n');
}

/// A public module of the crate root with its names.
fn module(item: &Item) -> Option<(String, Vec<Export>)> {
    let Item::Mod(module) = item else { return None };
    let hidden = says(&module.attrs, "doc", "hidden") || !is_public(&module.vis);
    let (_, items) = module.content.as_ref().filter(|_| !hidden)?;
    Some((module.ident.to_string(), exports(items)))
}

#[test]
fn the_public_api_is_the_reviewed_one() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let library = syn::parse_file(&fs::read_to_string(root.join("src/lib.rs")).unwrap()).unwrap();
    let at_root = exports(&library.items);
    let modules: Vec<(String, Vec<Export>)> = library.items.iter().filter_map(module).collect();
    let in_modules: Vec<&Export> = modules.iter().flat_map(|(_, names)| names).collect();
    let all: Vec<&Export> = at_root.iter().chain(in_modules.iter().copied()).collect();
    let stages = stages(root, &all);

    let mut text = format!("The crate root: {} names\n\n", at_root.len());
    for export in &at_root {
        describe(export, &stages, &mut text);
    }
    let known: BTreeSet<(&str, &str)> = at_root
        .iter()
        .map(|e| (e.stage.as_str(), e.declared.as_str()))
        .collect();
    for (module, names) in &modules {
        writeln!(text, "\nModule {module}: {} names\n", names.len()).unwrap();
        for export in names {
            if known.contains(&(export.stage.as_str(), export.declared.as_str())) {
                writeln!(text, "// {}: see the crate root\n", export.name).unwrap();
            } else {
                describe(export, &stages, &mut text);
            }
        }
    }
    let counts = (at_root.len(), in_modules.len());
    assert!(
        counts.0 <= MAX_NAMES.0 && counts.1 <= MAX_NAMES.1,
        "names at the root and in modules: {counts:?}"
    );

    let golden = root.join("tests/golden/public_api.txt");
    if std::env::var_os(UPDATE).is_some() {
        fs::write(&golden, &text).unwrap();
    }
    let reviewed = fs::read_to_string(&golden).unwrap_or_default();
    let changed = text
        .lines()
        .zip(reviewed.lines())
        .find(|(now, then)| now != then);
    assert!(
        text == reviewed,
        "the public API changed ({changed:?}); review it after {UPDATE}=1 cargo test --test tests -- public_api"
    );
}
