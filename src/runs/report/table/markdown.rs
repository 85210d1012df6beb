//! Tables as Markdown.

use super::{Alignment, Table};
use crate::report::visible::markdown_cell;

impl Table {
    /// The table with a line feed at its end.
    pub fn markdown(&self) -> String {
        let rule = |side: &Alignment| match side {
            Alignment::Left => "---".to_owned(),
            Alignment::Right => "---:".to_owned(),
        };
        let rules: Vec<String> = self.alignment.iter().map(rule).collect();
        let lines = [&self.headers, &rules].into_iter().chain(&self.rows);
        let line = |cells: &Vec<String>| {
            // A header may have several lines for terminals.
            let cells = cells
                .iter()
                .map(|cell| markdown_cell(&cell.replace('\n', " ")));
            cells.collect::<Vec<_>>().join(" | ")
        };
        lines
            .flat_map(|cells| ["| ".to_owned(), line(cells), " |\n".to_owned()])
            .collect()
    }
}
