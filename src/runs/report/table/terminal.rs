//! Tables and lists for a terminal.

use super::{Alignment, Table};
use comfy_table::{CellAlignment, presets};
use console::{measure_text_width, style};

/// Width of a terminal if nothing else is known, columns.
pub const COLUMNS: usize = 80;

impl Table {
    /// The table without a frame.
    pub fn terminal(&self) -> String {
        self.lines().join("\n")
    }

    /// The table with the first cell of each row on a line of its own, once for equal neighbors:
    /// long names take no width.
    pub fn terminal_below_names(mut self) -> String {
        let header_lines = self
            .headers
            .iter()
            .map(|header| header.split('\n').count())
            .max()
            .unwrap_or(1);
        let rows = std::iter::once(&mut self.headers)
            .chain(&mut self.rows)
            .filter(|row| !row.is_empty());
        let mut names: Vec<String> = rows.map(|row| row.remove(0)).collect();
        self.alignment.remove(0);
        // The further lines of the header belong to its name.
        let header = names.first().cloned().unwrap_or_default();
        names.splice(0..0, vec![header; header_lines - 1]);
        let mut last = None;
        let named = names.iter().zip(self.lines()).flat_map(|(name, line)| {
            let heading =
                (last.replace(name) != Some(name)).then(|| style(name).bold().to_string());
            heading.into_iter().chain([line])
        });
        named.collect::<Vec<_>>().join("\n")
    }

    fn lines(&self) -> Vec<String> {
        let mut table = comfy_table::Table::new();
        table.load_style(presets::NOTHING);
        table.set_header(&self.headers);
        table.add_rows(&self.rows);
        for (column, side) in table.column_iter_mut().zip(&self.alignment) {
            column.set_padding((0, 2));
            if *side == Alignment::Right {
                column.set_cell_alignment(CellAlignment::Right);
            }
        }
        table
            .lines()
            .map(|line| line.trim_end().to_owned())
            .collect()
    }
}

/// Words in lines of at most `width` columns, with two spaces between words. A longer word has a
/// line of its own.
pub fn fill(words: impl IntoIterator<Item = String>, width: usize) -> Vec<String> {
    joined(words, "  ", width)
}

/// A sentence in lines of [`COLUMNS`].
pub fn wrapped(text: &str) -> Vec<String> {
    joined(text.split_whitespace().map(str::to_owned), " ", COLUMNS)
}

fn joined(words: impl IntoIterator<Item = String>, gap: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in words {
        match lines.last_mut() {
            Some(line)
                if measure_text_width(line) + gap.len() + measure_text_width(&word) <= width =>
            {
                line.push_str(gap);
                line.push_str(&word);
            }
            _ => lines.push(word),
        }
    }
    lines
}
