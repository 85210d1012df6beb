//! `planagent models families`.

use crate::{Exit, Printer};
use planagent_mllm::{About, Architecture, Families};
use planagent_runs::report::table::Table;
use serde::Serialize;

/// What `docs/supported-models.md` begins with.
const HEAD: &str = "\
# Supported models

After this page you can tell whether a model opens, in which formats, and what its answers were compared with.

This page is written by `planagent models families --markdown`, from the registry of families; a test compares. A model opens if its
`config.json` names a family below, by `model_type` or by the first of `architectures`. A GGUF file of llama.cpp opens by its decoder, with
the projector beside it where the table has one. With `vision = false`, the decoder of a pair opens as a language model.
[models.md](models.md) says how to name a model, and which weight formats there are.
";
/// What it ends with.
const END: &str = "\
Safetensors and GGUF files of `models quantize` open in every family. The tests compare image features, logits and greedy tokens of tiny
models with random weights. The last part of a cell is where they are. `planagent models check MODEL` opens all of a model but its weights.
";

/// A family as it is printed.
#[derive(Debug, Serialize)]
struct Row {
    family: &'static str,
    models: &'static str,
    /// `model_type` and entries of `architectures`.
    config: &'static [&'static str],
    /// Decoders of llama.cpp's files, and the projector beside each.
    gguf: Vec<Pair>,
    tested: &'static str,
    example: &'static str,
}

#[derive(Debug, Serialize)]
struct Pair {
    decoder: &'static str,
    projector: Option<&'static str>,
}

impl Row {
    fn from_architecture(architecture: Architecture) -> Self {
        let family = architecture.family();
        let About {
            models,
            gguf,
            tested,
            example,
        } = family.about;
        let pair = |(decoder, projector): &(&'static str, Option<&'static str>)| Pair {
            decoder,
            projector: *projector,
        };
        Self {
            family: family.name,
            models,
            config: family.config_names,
            gguf: gguf.iter().map(pair).collect(),
            tested,
            example,
        }
    }

    /// The files of llama.cpp in words.
    fn gguf(&self, quote: &str) -> String {
        let pair = |pair: &Pair| match pair.projector {
            Some(projector) => {
                format!(
                    "{quote}{}{quote} with {quote}{projector}{quote}",
                    pair.decoder
                )
            }
            None => format!("{quote}{}{quote}", pair.decoder),
        };
        let pairs: Vec<String> = self.gguf.iter().map(pair).collect();
        if pairs.is_empty() {
            "-".to_owned()
        } else {
            pairs.join(", ")
        }
    }

    /// The names of `config.json` that are `model_type`s: classes are in camel case.
    fn model_types(&self) -> impl Iterator<Item = &'static str> {
        let is_type = |name: &&&str| !name.starts_with(|first: char| first.is_ascii_uppercase());
        self.config.iter().filter(is_type).copied()
    }
}

/// Prints the families, as a table, as JSON or as the page of the documentation.
pub(super) fn run(markdown: bool, printer: Printer) -> anyhow::Result<Exit> {
    let rows: Vec<Row> = Families::default()
        .iter()
        .map(Row::from_architecture)
        .collect();
    // This output is docs/supported-models.md, so it does not depend on the width of a terminal.
    if markdown {
        for line in page(&rows).lines() {
            printer.line(line);
        }
    } else if printer.is_json() {
        for row in &rows {
            printer.json(row)?;
        }
    } else {
        let cells = |row: &Row| {
            vec![
                row.family.to_owned(),
                row.model_types().collect::<Vec<_>>().join(", "),
                row.gguf(""),
                row.example.to_owned(),
            ]
        };
        let headers = [
            "family",
            "config.json",
            "decoder with projector (GGUF)",
            "example",
        ];
        let table = Table::new(headers, 1, rows.iter().map(cells))
            .with_texts(1)
            .with_texts(2)
            .with_texts(3);
        printer.table(table.fitted(printer.line_width()));
    }
    Ok(Exit::Success)
}

/// `docs/supported-models.md`.
fn page(rows: &[Row]) -> String {
    let mut text = format!(
        "{HEAD}\n| family | models | `config.json` | GGUF of llama.cpp | compared with | example |\n\
         |---|---|---|---|---|---|\n"
    );
    let line = |row: &Row| {
        let types: Vec<String> = row.model_types().map(|name| format!("`{name}`")).collect();
        format!(
            "| `{}` | {} | {} | {} | {} | `--model {}` |\n",
            row.family,
            row.models,
            types.join(", "),
            row.gguf("`"),
            row.tested,
            row.example
        )
    };
    text.extend(rows.iter().map(line));
    text + "\n" + END
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn root() -> &'static Path {
        Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
    }

    /// `planagent models families --markdown > docs/supported-models.md` writes it again.
    #[test]
    fn the_page_of_the_documentation_is_that_of_the_registry() {
        let rows: Vec<Row> = Families::default()
            .iter()
            .map(Row::from_architecture)
            .collect();
        let path = root().join("docs/supported-models.md");
        if std::env::var_os("PLANAGENT_UPDATE_GOLDEN").is_some() {
            std::fs::write(&path, page(&rows)).unwrap();
        }
        let written = std::fs::read_to_string(path).unwrap();
        assert_eq!(written, page(&rows));
    }

    #[test]
    fn what_a_family_says_of_itself_is_true() {
        for architecture in Families::default().iter() {
            let (row, family) = (Row::from_architecture(architecture), architecture.family());
            assert_eq!(row.gguf.is_empty(), family.gguf.is_err(), "{row:?}");
            assert!(row.model_types().next().is_some(), "{row:?}");
            let (_, folder) = row.tested.split_once(": ").unwrap();
            assert!(root().join(folder).exists(), "{row:?}");
            // A described model, or one of the hub.
            let described = root().join(format!("models/{}.toml", row.example));
            let text = std::fs::read_to_string(&described);
            match text {
                Ok(text) => assert!(text.contains(&format!("architecture = \"{}\"", row.family))),
                Err(_) => assert_eq!(row.example.matches('/').count(), 1, "{row:?}"),
            }
        }
    }
}
