//! Tables as Markdown.

use super::{Alignment, Table};

impl Table {
    /// The table with a line feed at its end.
    pub(super) fn markdown(&self) -> String {
        let rule = |side: &Alignment| match side {
            Alignment::Left => "---".to_owned(),
            Alignment::Right => "---:".to_owned(),
        };
        let rules: Vec<String> = self.alignment.iter().map(rule).collect();
        let lines = [&self.headers, &rules].into_iter().chain(&self.rows);
        lines.flat_map(|cells| ["| ".to_owned(), cells.join(" | "), " |\n".to_owned()]).collect()
    }
}
