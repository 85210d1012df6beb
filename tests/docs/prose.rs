//! The form of the pages.

use super::text::{without_blocks, without_code};
use super::{docs, markdown, name, read, root};
use regex::Regex;

/// More numbers in a sentence stand in a table.
const MAX_NUMBERS: usize = 5;
/// Words of README.md outside code blocks.
const MAX_README_WORDS: usize = 700;

#[test]
fn every_page_begins_with_what_its_reader_can_do_after_it() {
    for page in docs() {
        let text = read(&page);
        let first = text
            .lines()
            .skip(1)
            .find(|line| !line.is_empty())
            .unwrap_or_default();
        assert!(
            first.starts_with("After this page you can "),
            "{}: {first}",
            name(&page)
        );
    }
}

#[test]
fn numbers_stand_in_tables() {
    let number = Regex::new(r"(?:^|[^\w.])-?\d[\d,.]*").unwrap();
    let sentence = Regex::new(r"[.:;?] ").unwrap();
    let mut wrong = Vec::new();
    for page in docs().into_iter().chain([root().join("README.md")]) {
        let text = without_code(&read(&page));
        // Paragraphs and items of lists; tables, headings and remarks of the source have no
        // sentences.
        let is_prose = |line: &str| {
            !["|", "#", "<!--"]
                .iter()
                .any(|start| line.trim_start().starts_with(start))
        };
        let lines: Vec<&str> = text
            .lines()
            .map(|line| if is_prose(line) { line.trim() } else { "" })
            .collect();
        let blocks = lines.join("\n").replace("\n- ", "\n\n- ");
        for block in blocks.split("\n\n") {
            let block = block.replace('\n', " ");
            for sentence in sentence.split(&block) {
                let numbers = number.find_iter(sentence).count();
                if numbers > MAX_NUMBERS {
                    wrong.push(format!("{}: {numbers} numbers: {sentence}", name(&page)));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn the_readme_is_short() {
    let words = without_blocks(&read(&root().join("README.md")))
        .split_whitespace()
        .count();
    assert!(words <= MAX_README_WORDS, "README.md has {words} words");
}

#[test]
fn rows_of_tables_have_the_cells_of_their_header_and_do_not_repeat_it() {
    let folders = [
        ".",
        "docs",
        "docs/cards",
        "docs/decisions",
        "models/nano",
        "prompts",
    ];
    let mut wrong = Vec::new();
    let mut rows = 0;
    for page in folders
        .iter()
        .flat_map(|folder| markdown(&root().join(folder)))
    {
        let text = read(&page);
        let lines: Vec<&str> = text.lines().collect();
        for (header, below) in lines.windows(2).enumerate() {
            let [head, rule] = below else { continue };
            let is_rule = rule.starts_with('|') && rule.chars().all(|c| "|-: ".contains(c));
            if !head.starts_with('|') || !is_rule {
                continue;
            }
            let body = lines[header + 2..].iter();
            for (i, row) in body.take_while(|row| row.starts_with('|')).enumerate() {
                rows += 1;
                if row == head || cells(row) != cells(head) {
                    wrong.push(format!("{}:{}: {row}", name(&page), header + 3 + i));
                }
            }
        }
    }
    assert!(rows > 1_000, "{rows} rows");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Cells of a row. A pipe behind a backslash belongs to its cell.
fn cells(row: &str) -> usize {
    row.replace(r"\|", "").matches('|').count() - 1
}
