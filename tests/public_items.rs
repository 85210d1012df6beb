//! What an inner crate opens, another crate uses; everything else is `pub(crate)` or private.
//!
//! A name counts as used where another crate's sources have the word, so a common name may hide an
//! unused item, but no used item is found unused. What stands in the public part of a used item, as
//! a type of a signature, is used too. Items that a macro makes are not seen.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use syn::{Attribute, File, ImplItem, Item, Type, UseTree, Visibility};

/// What stands beside the inner crates and may use them.
const USERS: [&str; 8] = [
    "src/lib.rs",
    "src/main.rs",
    "src/api",
    "tests",
    "benches",
    "examples",
    "fuzz",
    "python/src",
];

/// A public item of a crate.
#[derive(Debug)]
struct PublicItem {
    /// Where it is declared.
    file: String,
    /// What it is, for the message.
    kind: &'static str,
    name: String,
    /// The words of its public part.
    interface: BTreeSet<String>,
}

/// The words of Rust code without comments, strings and numbers.
fn words(code: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    let mut rest = code;
    while let Some(first) = rest.chars().next() {
        rest = if rest.starts_with("//") {
            rest.split_once('\n').map_or("", |(_, next)| next)
        } else if rest.starts_with("/*") {
            rest.split_once("*/").map_or("", |(_, next)| next)
        } else if let Some(behind) = behind_raw_string(rest) {
            behind
        } else if first == '"' {
            behind_quote(&rest[1..])
        } else if first == '\'' {
            behind_tick(&rest[1..])
        } else if first.is_alphanumeric() || first == '_' {
            let end = rest
                .find(|c: char| !(c.is_alphanumeric() || c == '_'))
                .unwrap_or(rest.len());
            found.insert(rest[..end].to_owned());
            &rest[end..]
        } else {
            &rest[first.len_utf8()..]
        };
    }
    found
}

/// What stands behind a raw string, if the text begins with one.
fn behind_raw_string(text: &str) -> Option<&str> {
    let open = text.strip_prefix("br").or_else(|| text.strip_prefix('r'))?;
    let hashes = open.len() - open.trim_start_matches('#').len();
    let inside = open[hashes..].strip_prefix('"')?;
    let close = format!("\"{}", "#".repeat(hashes));
    Some(inside.split_once(&close).map_or("", |(_, behind)| behind))
}

/// What stands behind the end of a string that has begun.
fn behind_quote(text: &str) -> &str {
    let mut escaped = false;
    for (at, c) in text.char_indices() {
        match c {
            '"' if !escaped => return &text[at + 1..],
            '\\' => escaped = !escaped,
            _ => escaped = false,
        }
    }
    ""
}

/// What stands behind a character, or behind the tick of a lifetime.
fn behind_tick(text: &str) -> &str {
    let mut characters = text.chars();
    match (characters.next(), characters.next()) {
        (Some('\\'), Some(escaped)) => {
            let rest = &text[1 + escaped.len_utf8()..];
            rest.split_once('\'').map_or("", |(_, behind)| behind)
        }
        (Some(one), Some('\'')) => &text[one.len_utf8() + 1..],
        _ => text,
    }
}

/// All Rust files of a folder, or the file.
fn rust_files(path: &Path, found: &mut Vec<PathBuf>) {
    if path.is_file() {
        found.push(path.to_owned());
        return;
    }
    let mut entries: Vec<PathBuf> = fs::read_dir(path)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    entries.sort();
    for entry in entries {
        let is_rust = entry.extension().is_some_and(|extension| extension == "rs");
        let is_build = entry.ends_with("target");
        if entry.is_dir() && !is_build || is_rust {
            rust_files(&entry, found);
        }
    }
}

fn is_public(visibility: &Visibility) -> bool {
    matches!(visibility, Visibility::Public(_))
}

/// Whether an item exists in tests alone.
fn is_test(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| match &attribute.meta {
        syn::Meta::List(list) => {
            list.path.is_ident("cfg") && words(&list.tokens.to_string()).contains("test")
        }
        _ => false,
    })
}

/// The words of a declaration; `item` has lost its bodies and private parts.
fn interface(item: Item) -> BTreeSet<String> {
    words(&prettyplease::unparse(&File {
        shebang: None,
        frontmatter: None,
        attrs: vec![],
        items: vec![item],
    }))
}

/// Leaves the public fields alone.
fn public_fields(fields: &mut syn::Fields) {
    match fields {
        syn::Fields::Named(named) => {
            let all = std::mem::take(&mut named.named);
            named.named = all
                .into_iter()
                .filter(|field| is_public(&field.vis))
                .collect();
        }
        syn::Fields::Unnamed(unnamed) => {
            let all = std::mem::take(&mut unnamed.unnamed);
            unnamed.unnamed = all
                .into_iter()
                .filter(|field| is_public(&field.vis))
                .collect();
        }
        syn::Fields::Unit => {}
    }
}

/// The kind, the name and the public part of a public item; `None` for another.
fn public_item(item: &Item) -> Option<(&'static str, String, Item)> {
    let mut item = item.clone();
    let (kind, name) = match &mut item {
        Item::Struct(it) if is_public(&it.vis) => {
            public_fields(&mut it.fields);
            ("struct", it.ident.to_string())
        }
        Item::Enum(it) if is_public(&it.vis) => ("enum", it.ident.to_string()),
        Item::Trait(it) if is_public(&it.vis) => {
            for inner in &mut it.items {
                if let syn::TraitItem::Fn(method) = inner {
                    method.default = None;
                }
            }
            ("trait", it.ident.to_string())
        }
        Item::Fn(it) if is_public(&it.vis) => {
            it.block = syn::parse_quote!({});
            ("fn", it.sig.ident.to_string())
        }
        Item::Const(it) if is_public(&it.vis) => {
            it.expr = syn::parse_quote!(_);
            ("const", it.ident.to_string())
        }
        Item::Static(it) if is_public(&it.vis) => {
            it.expr = syn::parse_quote!(_);
            ("static", it.ident.to_string())
        }
        Item::Type(it) if is_public(&it.vis) => ("type", it.ident.to_string()),
        Item::Mod(it) if is_public(&it.vis) => {
            it.content = None;
            it.semi = Some(syn::parse_quote!(;));
            ("mod", it.ident.to_string())
        }
        _ => return None,
    };
    Some((kind, name, item))
}

/// The public items of a file, and the types that implementations of traits open.
fn read_items(file: &str, items: &[Item], found: &mut Vec<PublicItem>) {
    let mut add = |kind, name: String, declaration: Item| {
        found.push(PublicItem {
            file: file.to_owned(),
            kind,
            name,
            interface: interface(declaration),
        });
    };
    for item in items {
        match item {
            Item::Impl(item) if item.trait_.is_none() && !is_test(&item.attrs) => {
                for inner in &item.items {
                    let mut alone = item.clone();
                    let (kind, name) = match inner {
                        ImplItem::Fn(method)
                            if is_public(&method.vis) && !is_test(&method.attrs) =>
                        {
                            let mut method = method.clone();
                            method.block = syn::parse_quote!({});
                            let name = method.sig.ident.to_string();
                            alone.items = vec![ImplItem::Fn(method)];
                            ("fn", name)
                        }
                        ImplItem::Const(constant) if is_public(&constant.vis) => {
                            let mut constant = constant.clone();
                            constant.expr = syn::parse_quote!(_);
                            let name = constant.ident.to_string();
                            alone.items = vec![ImplItem::Const(constant)];
                            ("const", name)
                        }
                        _ => continue,
                    };
                    add(kind, name, Item::Impl(alone));
                }
            }
            _ => {
                let attributes = match item {
                    Item::Struct(it) => &it.attrs,
                    Item::Enum(it) => &it.attrs,
                    Item::Trait(it) => &it.attrs,
                    Item::Fn(it) => &it.attrs,
                    Item::Const(it) => &it.attrs,
                    Item::Type(it) => &it.attrs,
                    Item::Mod(it) => &it.attrs,
                    _ => continue,
                };
                if let Some((kind, name, declaration)) = public_item(item)
                    && !is_test(attributes)
                {
                    add(kind, name, declaration);
                }
            }
        }
    }
}

/// The words that implementations of traits open: their associated types.
fn associated_types(items: &[Item]) -> BTreeMap<String, BTreeSet<String>> {
    let mut found = BTreeMap::<String, BTreeSet<String>>::new();
    for item in items {
        let Item::Impl(item) = item else { continue };
        let Type::Path(own) = &*item.self_ty else {
            continue;
        };
        let (Some(own), Some(_)) = (own.path.segments.last(), &item.trait_) else {
            continue;
        };
        let mut types = item.clone();
        types
            .items
            .retain(|inner| matches!(inner, ImplItem::Type(_)));
        if !types.items.is_empty() {
            let words = interface(Item::Impl(types));
            found
                .entry(own.ident.to_string())
                .or_default()
                .extend(words);
        }
    }
    found
}

/// Adds the names that a file gives to others: the name itself, and the one that users see.
fn renames(tree: &UseTree, found: &mut Vec<(String, String)>) {
    match tree {
        UseTree::Path(path) => renames(&path.tree, found),
        UseTree::Group(group) => group.items.iter().for_each(|tree| renames(tree, found)),
        UseTree::Rename(rename) => {
            found.push((rename.ident.to_string(), rename.rename.to_string()));
        }
        UseTree::Name(_) | UseTree::Glob(_) => {}
    }
}

/// The public items of a crate that no other crate uses: `others` has the words of these.
fn unused(files: &[(String, File)], others: &BTreeSet<String>) -> Vec<PublicItem> {
    let mut items = Vec::new();
    let mut opened = BTreeMap::<String, BTreeSet<String>>::new();
    for (file, parsed) in files {
        read_items(file, &parsed.items, &mut items);
        for (name, words) in associated_types(&parsed.items) {
            opened.entry(name).or_default().extend(words);
        }
    }
    let (mut renamed, mut shown) = (Vec::new(), BTreeSet::new());
    for item in files.iter().flat_map(|(_, parsed)| &parsed.items) {
        match item {
            Item::Use(item) => renames(&item.tree, &mut renamed),
            // What a macro makes may show what it names.
            Item::Macro(item) => shown.extend(words(&item.mac.tokens.to_string())),
            _ => {}
        }
    }
    let is_named = |name: &String| {
        let is_renamed = |(own, seen): &(String, String)| own == name && others.contains(seen);
        others.contains(name) || renamed.iter().any(is_renamed)
    };
    // Functions are used by name alone; types also where a used item shows them.
    loop {
        let mut unused = Vec::new();
        let before = shown.len();
        for item in items {
            let is_used = is_named(&item.name) || item.kind != "fn" && shown.contains(&item.name);
            if is_used {
                shown.extend(item.interface.iter().cloned());
                shown.extend(opened.get(&item.name).into_iter().flatten().cloned());
            } else {
                unused.push(item);
            }
        }
        if shown.len() == before {
            return unused;
        }
        items = unused;
    }
}

#[test]
fn what_a_crate_opens_another_crate_uses() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |path: &Path| fs::read_to_string(path).unwrap();
    let all_words = |paths: &[PathBuf]| -> BTreeSet<String> {
        paths.iter().flat_map(|path| words(&read(path))).collect()
    };
    let mut users = Vec::new();
    for user in USERS {
        rust_files(&root.join(user), &mut users);
    }
    // The names of the public API are for the users of the library.
    let mut users = all_words(&users);
    users.extend(words(&read(&root.join("tests/golden/public_api.txt"))));

    let mut crates: Vec<PathBuf> = fs::read_dir(root.join("src"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|folder| folder.join("lib.rs").exists())
        .collect();
    crates.sort();
    let sources: Vec<Vec<PathBuf>> = crates
        .iter()
        .map(|folder| {
            let mut files = Vec::new();
            rust_files(folder, &mut files);
            files
        })
        .collect();
    let vocabulary: Vec<BTreeSet<String>> = sources.iter().map(|files| all_words(files)).collect();

    let mut wrong = Vec::new();
    for (own, files) in sources.iter().enumerate() {
        let mut others = users.clone();
        for (other, words) in vocabulary.iter().enumerate() {
            if other != own {
                others.extend(words.iter().cloned());
            }
        }
        let parsed: Vec<(String, File)> = files
            .iter()
            .map(|path| {
                let file = path.strip_prefix(root).unwrap().display().to_string();
                (file, syn::parse_file(&read(path)).unwrap())
            })
            .collect();
        let unused = unused(&parsed, &others);
        wrong.extend(
            unused
                .iter()
                .map(|item| format!("{}: pub {} {}", item.file, item.kind, item.name)),
        );
    }
    assert!(
        wrong.is_empty(),
        "{} public items that no other crate uses; make them pub(crate), or remove them:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}

#[test]
fn the_scan_sees_what_it_should() {
    let code = "use a::B; // comment\n/* block */ let c = 'd'; let e: &'f str = \"g \\\" h\"; r#\"i \" j\"#; k('\\'')";
    let expected = ["B", "a", "c", "e", "f", "k", "let", "str", "use"];
    assert_eq!(
        words(code).iter().map(String::as_str).collect::<Vec<_>>(),
        expected
    );
    let source = "
        pub struct Used { pub shown: Shown, hidden: Hidden }
        pub struct Shown;
        pub struct Hidden;
        impl Used { pub fn called() -> Returned { todo!() } pub fn idle() {} fn own() {} }
        pub enum Returned { A(Deep) }
        pub struct Deep;
        impl Iterator for Used { type Item = Listed; fn next(&mut self) -> Option<Listed> { None } }
        pub struct Listed;
        pub(crate) struct Inner;
        #[cfg(test)] pub fn tested() {}
        mod inner { pub fn below() {} }
    ";
    let files = [("a.rs".to_owned(), syn::parse_file(source).unwrap())];
    let others = words("x.called(); let y: Used;");
    let found: Vec<String> = unused(&files, &others)
        .into_iter()
        .map(|item| item.name)
        .collect();
    assert_eq!(found, ["Hidden", "idle"]);
}
