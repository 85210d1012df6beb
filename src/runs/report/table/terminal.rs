//! Tables and lists for a terminal.

use super::{Alignment, Table};
use comfy_table::{CellAlignment, presets};
use console::{measure_text_width, style};

/// Width of a terminal if nothing else is known, columns.
pub const COLUMNS: usize = 80;
/// Minimum width of a table: a narrower terminal wraps its lines.
const MIN_COLUMNS: usize = 40;
/// Minimum width of a last column of words.
const MIN_REST: usize = 9;
/// Characters after which a name may be broken.
const SEPARATORS: [char; 7] = ['/', '~', '_', '-', ',', '.', ' '];

/// The width that tables may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LineWidth {
    columns: usize,
    breaks_names: bool,
}

impl LineWidth {
    /// A file or a pipe: [`COLUMNS`], and names stay whole for other programs.
    pub const PIPE: Self = Self {
        columns: COLUMNS,
        breaks_names: false,
    };

    /// A terminal of so many columns. A longer name continues on the next line.
    pub fn terminal(columns: u16) -> Self {
        Self {
            columns: usize::from(columns).max(MIN_COLUMNS),
            breaks_names: true,
        }
    }

    /// Its columns.
    pub fn columns(self) -> usize {
        self.columns
    }

    /// The lines of a name.
    pub fn name(self, name: &str) -> Vec<String> {
        if self.breaks_names {
            broken(name, self.columns)
        } else {
            vec![name.to_owned()]
        }
    }

    /// A sentence in lines of this width.
    pub fn wrapped(self, text: &str) -> Vec<String> {
        let words = text.split_whitespace();
        joined(
            words.flat_map(|word| broken(word, self.columns)),
            " ",
            self.columns,
        )
    }

    /// Short texts side by side, two spaces apart. A text wider than a line is wrapped.
    pub fn listed(self, texts: impl IntoIterator<Item = String>) -> Vec<String> {
        let lines = fill(texts, self.columns).into_iter();
        lines
            .flat_map(|line| {
                if measure_text_width(&line) <= self.columns {
                    vec![line]
                } else {
                    self.wrapped(&line)
                }
            })
            .collect()
    }
}

impl Table {
    /// The table without a frame. If it is too wide, the first cells stand on lines of their own; on a
    /// terminal, columns that do not fit even then follow in tables below.
    pub fn fitted(self, width: LineWidth) -> String {
        let lines = self.lines();
        if widest(&lines) <= width.columns {
            lines.join("\n")
        } else {
            self.fitted_below_names(width)
        }
    }

    /// The table with the first cell of each row on a line of its own, once for equal neighbors:
    /// long names take no width. On a terminal, columns that do not fit follow in tables below.
    pub fn fitted_below_names(mut self, width: LineWidth) -> String {
        if !width.breaks_names {
            return self.below_names(width);
        }
        self.fit_texts(width.columns);
        let blocks = self.blocks(width.columns);
        let blocks = blocks.into_iter().map(|block| block.below_names(width));
        blocks.collect::<Vec<_>>().join("\n\n")
    }

    /// Whether it needs no second table below, the first cells on lines of their own.
    pub(super) fn fits_below_names(&self, width: LineWidth) -> bool {
        let shown: Vec<usize> = (1..self.headers.len()).collect();
        widest(&self.of_columns(&shown).lines()) <= width.columns
    }

    /// Wraps the cells of the last column at their commas, so that the table takes the width with the
    /// first cells on lines of their own.
    pub(super) fn wrap_last(&mut self, width: LineWidth) {
        if width.breaks_names {
            self.break_texts(width.columns / 3);
        }
        let last = self.headers.len().saturating_sub(1);
        let before: Vec<usize> = (1..last).collect();
        let before = widest(&self.of_columns(&before).lines()) + self.gap;
        let rest = width.columns.saturating_sub(before).max(MIN_REST);
        for cell in self.rows.iter_mut().filter_map(|row| row.get_mut(last)) {
            let parts = cell.split(", ").flat_map(|part| broken(part, rest));
            *cell = joined(parts, ", ", rest).join("\n");
        }
    }

    /// The same with texts on the left in a column.
    #[must_use]
    pub fn with_texts(mut self, column: usize) -> Self {
        if let Some(side) = self.alignment.get_mut(column) {
            *side = Alignment::Left;
        }
        self
    }

    /// The same with texts on the left in its last column.
    pub(super) fn ending_in_text(self) -> Self {
        let last = self.headers.len().saturating_sub(1);
        self.with_texts(last)
    }

    /// The same with another gap between columns.
    #[must_use]
    pub fn with_gap(self, gap: usize) -> Self {
        Self { gap, ..self }
    }

    /// Breaks texts beside the first column, so that they take the width with any other column.
    fn fit_texts(&mut self, columns: usize) {
        let texts: Vec<usize> = (1..self.texts()).collect();
        let others =
            (self.texts().max(1)..self.headers.len()).map(|column| self.of_columns(&[column]));
        let others = others.map(|other| widest(&other.lines()) + self.gap).max();
        let room = columns.saturating_sub(others.unwrap_or(0));
        let whole = self.clone();
        self.break_texts(columns / 2);
        let mut limit = columns / 2;
        while limit > MIN_REST && widest(&self.of_columns(&texts).lines()) > room {
            limit -= 1;
            self.clone_from(&whole);
            self.break_texts(limit);
            for header in self.headers.iter_mut().take(texts.len() + 1).skip(1) {
                *header = broken(header, limit).join("\n");
            }
        }
    }

    /// Breaks texts beside the first column that take more than `columns`.
    fn break_texts(&mut self, columns: usize) {
        let texts = self.texts();
        for row in &mut self.rows {
            for cell in row.iter_mut().take(texts).skip(1) {
                let lines = cell.split('\n').flat_map(|line| broken(line, columns));
                *cell = lines.collect::<Vec<_>>().join("\n");
            }
        }
    }

    /// Number of columns on the left that are texts.
    fn texts(&self) -> usize {
        let sides = self.alignment.iter();
        sides.take_while(|side| **side == Alignment::Left).count()
    }

    /// The columns in as many tables as the width asks for, each with the texts on the left.
    fn blocks(&self, columns: usize) -> Vec<Self> {
        let all = self.headers.len();
        let texts: Vec<usize> = (0..self.texts().clamp(1, all.max(1))).collect();
        let fits = |own: &[usize]| {
            let (_, shown) = own.split_first().unwrap_or((&0, own));
            widest(&self.of_columns(shown).lines()) <= columns
        };
        let (mut blocks, mut own) = (Vec::new(), texts.clone());
        for column in texts.len()..all {
            own.push(column);
            if own.len() > texts.len() + 1 && !fits(&own) {
                own.pop();
                blocks.push(self.of_columns(&own));
                own.clone_from(&texts);
                own.push(column);
            }
        }
        blocks.push(self.of_columns(&own));
        blocks
    }

    /// The table with these columns.
    fn of_columns(&self, columns: &[usize]) -> Self {
        fn picked<T: Clone>(cells: &[T], columns: &[usize]) -> Vec<T> {
            let known = columns.iter().filter_map(|&column| cells.get(column));
            known.cloned().collect()
        }
        Self {
            headers: picked(&self.headers, columns),
            alignment: picked(&self.alignment, columns),
            rows: self.rows.iter().map(|row| picked(row, columns)).collect(),
            gap: self.gap,
        }
    }

    /// The lines with the first cells above them.
    fn below_names(&self, width: LineWidth) -> String {
        let rest: Vec<usize> = (1..self.headers.len()).collect();
        let rest = self.of_columns(&rest);
        let mut lines = rest.lines().into_iter();
        let (mut text, mut last) = (Vec::new(), None);
        let rows = std::iter::once(&self.headers).chain(&self.rows);
        let others = std::iter::once(&rest.headers).chain(&rest.rows);
        for (row, others) in rows.zip(others) {
            let name = row.first();
            if let Some(name) = name.filter(|name| last != Some(*name)) {
                let parts = width.name(name).into_iter();
                text.extend(parts.map(|part| style(part).bold().to_string()));
            }
            last = name;
            let height = others.iter().map(|cell| cell.split('\n').count()).max();
            text.extend(lines.by_ref().take(height.unwrap_or(0)));
        }
        text.join("\n")
    }

    fn lines(&self) -> Vec<String> {
        let mut table = comfy_table::Table::new();
        table.load_style(presets::NOTHING);
        table.set_header(&self.headers);
        table.add_rows(&self.rows);
        let gap = u16::try_from(self.gap).unwrap_or(u16::MAX);
        for (column, side) in table.column_iter_mut().zip(&self.alignment) {
            column.set_padding((0, gap));
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

/// Columns between two columns of a table.
pub(super) const GAP: usize = 2;

fn widest(lines: &[String]) -> usize {
    let widths = lines.iter().map(|line| measure_text_width(line));
    widths.max().unwrap_or(0)
}

/// A name in lines of at most `columns`, broken after separators where it has some.
pub(super) fn broken(name: &str, columns: usize) -> Vec<String> {
    let columns = columns.max(1);
    let (mut lines, mut line) = (Vec::new(), String::new());
    for piece in name.split_inclusive(SEPARATORS) {
        if !line.is_empty() && measure_text_width(&line) + measure_text_width(piece) > columns {
            lines.push(std::mem::take(&mut line));
        }
        for letter in piece.chars() {
            if measure_text_width(&line) >= columns {
                lines.push(std::mem::take(&mut line));
            }
            line.push(letter);
        }
    }
    lines.push(line);
    lines
}

/// Words in lines of at most `width` columns, with two spaces between words. A longer word has a
/// line of its own.
pub fn fill(words: impl IntoIterator<Item = String>, width: usize) -> Vec<String> {
    joined(words, "  ", width)
}

/// Words in lines of at most `width` columns with a gap between them. A longer word has a line of its
/// own.
pub fn joined(words: impl IntoIterator<Item = String>, gap: &str, width: usize) -> Vec<String> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::table::tests::assert_fits;

    /// A table with names and numbers of many lengths.
    fn table(columns: usize) -> Table {
        let headers = (0..columns).map(|column| format!("column {column}"));
        let row = |name: &str, planner: &str| {
            let cells = (2..columns).map(|column| format!("{}.00", 10_i64.pow(column as u32 % 7)));
            let names = [name.to_owned(), format!(" {planner}")];
            names.into_iter().chain(cells).collect::<Vec<_>>()
        };
        let long = "generated/starting_straight_traffic_light_intersection_traversal/3~cones";
        let rows = [
            row("a", "idm"),
            row(
                long,
                "a-planner-with-a-name-that-nobody-would-ever-type-twice",
            ),
            row(long, "idm"),
        ];
        Table::new(headers, 2, rows)
    }

    #[test]
    fn tables_of_any_columns_fit_any_terminal() {
        console::set_colors_enabled(false);
        for columns in 2..20 {
            for terminal in [60, 80, 100, 160] {
                let text = table(columns).fitted(LineWidth::terminal(terminal));
                assert_fits(&text, terminal);
                for column in 0..columns {
                    assert!(text.contains(&format!("column {column}")), "{text}");
                }
            }
        }
    }

    #[test]
    fn tables_of_texts_fit_any_terminal() {
        console::set_colors_enabled(false);
        let headers = [
            "family",
            "names of the configuration",
            "decoder with projector",
            "example",
        ];
        let row = |name: &str, names: &str| {
            let cells = [
                name,
                names,
                "one-decoder with a_projector",
                "org/A-Model-Of-1B-Instruct",
            ];
            cells.map(ToOwned::to_owned).to_vec()
        };
        let rows = || {
            [
                row("a", "one, another_text, third_text_of_it"),
                row("a-longer-name", "x"),
            ]
        };
        for numbers in 0..3 {
            for terminal in [60, 72, 80, 100, 160] {
                let headers = headers.iter().map(ToString::to_string);
                let counts = (0..numbers).map(|number| format!("number {number}"));
                let rows = rows().map(|mut row| {
                    row.extend((0..numbers).map(|number| format!("{number}")));
                    row
                });
                let mut table = Table::new(headers.chain(counts), 1, rows);
                for column in 1..4 {
                    table = table.with_texts(column);
                }
                let text = table.fitted(LineWidth::terminal(terminal));
                assert_fits(&text, terminal);
                assert!(text.contains("Instruct"), "{text}");
            }
        }
    }

    #[test]
    fn names_stay_whole_in_a_pipe_and_cells_of_several_lines_keep_their_row() {
        console::set_colors_enabled(false);
        let text = table(12).fitted(LineWidth::PIPE);
        assert!(text.contains("traversal/3~cones\n"), "{text}");
        let headers = ["scenario", "n", "why"];
        let cells = |name: &str, why: &str| vec![name.to_owned(), "1".to_owned(), why.to_owned()];
        let rows = [
            cells("first", "many words, that take, two lines"),
            cells("second", "few"),
        ];
        let mut table = Table::new(headers, 1, rows).ending_in_text();
        table.wrap_last(LineWidth {
            columns: 24,
            breaks_names: true,
        });
        let text = table.fitted_below_names(LineWidth::terminal(60));
        assert_eq!(
            text,
            "scenario\nn  why\nfirst\n1  many words, that take\n   two lines\nsecond\n1  few"
        );
    }

    #[test]
    fn a_name_is_broken_after_separators() {
        assert_eq!(broken("one/two~three", 8), ["one/two~", "three"]);
        assert_eq!(broken("abcdefgh", 3), ["abc", "def", "gh"]);
        assert_eq!(broken("", 3), [""]);
    }
}
