//! The files of a card: Markdown, JSON, a page for browsers, and its plot.

use super::content::Card;
use super::plot;
use super::sections::{Block, Section};
use crate::report::StudyFolder;
use planagent_runs::report::page::document;
use planagent_runs::report::table::LineWidth;
use planagent_runs::report::{
    escaped, json_value, markdown_block, markdown_line, visible, visible_line,
};
use planagent_runs::runner::RunnerError;
use std::fmt::Write as _;
use std::path::Path;

/// The files in the folder of a card.
const JSON: &str = "card.json";
const MARKDOWN: &str = "card.md";
/// The page for browsers.
pub const CARD_PAGE: &str = "card.html";
/// The plot that the Markdown shows.
pub(super) const PLOT: &str = "calibration.svg";

/// The files that tell whether the program wrote a card, the first one with its command.
pub(super) const OWN: [&str; 2] = [JSON, MARKDOWN];
pub(super) const OWN_MARK: &str = "\"command\": \"planagent card";

/// Writes all files of a card; gives its JSON.
pub(super) fn write(
    folder: &Path,
    card: &Card,
    sections: &[Section],
) -> Result<serde_json::Value, RunnerError> {
    let json = json_value(card)?;
    let title = format!("Card of {}", card.model.name);
    let mut files = vec![
        (JSON, serde_json::to_string_pretty(&json)? + "\n"),
        (MARKDOWN, markdown(&title, &card.command, sections)),
        (CARD_PAGE, html(&title, &card.command, sections)),
    ];
    if let Some(calibration) = card.calibration.known() {
        files.push((PLOT, plot::draw(calibration)));
    }
    StudyFolder::new(folder.to_owned()).write_files(&files)?;
    Ok(json)
}

fn markdown(title: &str, command: &str, sections: &[Section]) -> String {
    let command = markdown_block("console", &format!("$ {command}"));
    let mut text = format!("# {}\n\n{command}\n", markdown_line(title));
    for section in sections {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "\n## {}", markdown_line(&section.title));
        for block in &section.blocks {
            let _ = match block {
                Block::Text(words) => writeln!(text, "\n{}", markdown_line(words)),
                Block::Table(table) => write!(text, "\n{}", table.markdown()),
                Block::Plot { title, .. } => {
                    writeln!(text, "\n![{}]({PLOT})", markdown_line(title))
                }
            };
        }
    }
    text
}

fn html(title: &str, command: &str, sections: &[Section]) -> String {
    let shown = |text: &str| escaped(&visible_line(text));
    let command = escaped(&visible(&format!("$ {command}")));
    let mut body = format!("<h1>{}</h1>\n<pre>{command}</pre>\n", shown(title));
    for section in sections {
        let _ = writeln!(body, "<h2>{}</h2>", shown(&section.title));
        for block in &section.blocks {
            let _ = match block {
                Block::Text(words) => writeln!(body, "<p class=\"note\">{}</p>", shown(words)),
                Block::Table(table) => {
                    writeln!(body, "<div class=\"scroll\">{}</div>", table.html())
                }
                Block::Plot { svg, .. } => writeln!(body, "<figure class=\"card\">{svg}</figure>"),
            };
        }
    }
    document(title, &body)
}

/// The card for a terminal.
pub fn card_text(sections: &[Section], width: LineWidth) -> String {
    let mut parts = Vec::new();
    for section in sections {
        let mut lines = vec![visible_line(&section.title).into_owned()];
        for block in &section.blocks {
            match block {
                Block::Text(words) => lines.extend(width.wrapped(&visible(words))),
                Block::Table(table) => lines.push(table.clone().fitted(width)),
                // A terminal has the bins in a table.
                Block::Plot { .. } => {}
            }
        }
        parts.push(lines.join("\n"));
    }
    parts.join("\n\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_runs::report::table::Table;

    #[test]
    fn names_from_outside_are_no_markup() {
        let hostile = "<script>alert(1)</script> ![x](http://a)";
        let row = vec![hostile.to_owned(), "1".to_owned()];
        let sections = [Section {
            title: hostile.to_owned(),
            blocks: vec![
                Block::Text(hostile.to_owned()),
                Block::Table(Table::new([hostile, "n"], 1, [row])),
            ],
        }];
        let page = html(hostile, hostile, &sections);
        assert!(!page.contains("<script>alert"), "{page}");
        let text = markdown(hostile, "planagent card", &sections);
        assert!(
            !text.contains("<script>") && !text.contains(" ![x]"),
            "{text}"
        );
        assert!(page.contains("class=\"number\""), "{page}");
    }
}
