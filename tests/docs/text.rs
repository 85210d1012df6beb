//! What a Markdown page consists of.

/// A command of a console block.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct DocumentedCommand {
    /// Number of its line, from 1.
    pub(super) line: usize,
    /// The command, its lines joined, without the comment behind it.
    pub(super) text: String,
    /// The lines that the page shows as its output.
    pub(super) output: Vec<String>,
}

/// The commands of all console blocks.
pub(super) fn commands(page: &str) -> Vec<DocumentedCommand> {
    let mut found: Vec<DocumentedCommand> = Vec::new();
    let (mut in_console, mut continues) = (false, false);
    for (i, line) in page.lines().enumerate() {
        if line.starts_with("```") {
            in_console = line == "```console";
            continues = false;
        } else if in_console {
            let command = line.strip_prefix("$ ");
            if let Some(last) = found.last_mut().filter(|_| continues) {
                last.text = format!(
                    "{} {}",
                    last.text.trim_end_matches('\\').trim_end(),
                    line.trim()
                );
            } else if let Some(command) = command {
                found.push(DocumentedCommand {
                    line: i + 1,
                    text: command.to_owned(),
                    output: Vec::new(),
                });
            } else {
                let last = found
                    .last_mut()
                    .unwrap_or_else(|| panic!("line {}: output before a command", i + 1));
                last.output.push(line.to_owned());
            }
            continues = line.ends_with('\\');
        }
    }
    for command in &mut found {
        if let Some((before, _)) = command
            .text
            .split_once("  #")
            .or_else(|| command.text.split_once(" # "))
        {
            command.text = before.trim_end().to_owned();
        }
    }
    found
}

/// A fenced block.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Block {
    /// Number of its first line, from 1.
    pub(super) line: usize,
    /// The word behind the fence.
    pub(super) language: String,
    pub(super) text: String,
}

/// The fenced blocks of a page.
pub(super) fn blocks(page: &str) -> Vec<Block> {
    let mut found: Vec<Block> = Vec::new();
    let mut is_open = false;
    for (i, line) in page.lines().enumerate() {
        if let Some(language) = line.strip_prefix("```") {
            is_open = !is_open;
            if is_open {
                found.push(Block {
                    line: i + 2,
                    language: language.to_owned(),
                    text: String::new(),
                });
            }
        } else if let Some(block) = found.last_mut().filter(|_| is_open) {
            block.text += line;
            block.text.push('\n');
        }
    }
    found
}

/// The page without code blocks, its lines kept.
pub(super) fn without_blocks(page: &str) -> String {
    let mut in_block = false;
    let lines = page.lines().map(|line| {
        let fence = line.trim_start().starts_with("```");
        in_block ^= fence;
        if in_block || fence { "" } else { line }
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// The page without what stands between backticks.
pub(super) fn without_code(page: &str) -> String {
    without_blocks(page)
        .lines()
        .map(|line| line.split('`').step_by(2).collect::<Vec<_>>().join(""))
        .collect::<Vec<_>>()
        .join("\n")
}

/// The targets of links and images with their lines.
pub(super) fn links(page: &str) -> Vec<(usize, String)> {
    let text = without_blocks(page);
    let mut found = Vec::new();
    for (i, line) in text.lines().enumerate() {
        for part in line.split("](").skip(1) {
            if let Some((target, _)) = part.split_once(')') {
                found.push((i + 1, target.to_owned()));
            }
        }
    }
    found
}

/// The anchors of a page's headings, as GitHub makes them.
pub(super) fn anchors(page: &str) -> Vec<String> {
    let text = without_blocks(page);
    let headings = text.lines().filter(|line| line.starts_with('#'));
    let slug = |heading: &str| -> String {
        let lower = heading.trim_start_matches('#').trim().to_lowercase();
        let kept = lower
            .chars()
            .filter(|c| c.is_alphanumeric() || " -_".contains(*c));
        kept.map(|c| if c == ' ' { '-' } else { c }).collect()
    };
    headings.map(slug).collect()
}

#[test]
fn commands_are_found_with_their_lines_and_output() {
    let page = "# A\n\n```console\n$ one --a \\\n    --b\nout\n$ two    # why\n```\n\n```toml\n$ no\n```\n";
    let found = commands(page);
    let command = |line, text: &str, output: &[&str]| DocumentedCommand {
        line,
        text: text.to_owned(),
        output: output.iter().map(|line| (*line).to_owned()).collect(),
    };
    assert_eq!(
        found,
        [command(4, "one --a --b", &["out"]), command(7, "two", &[])]
    );
}

#[test]
fn blocks_have_a_language_and_a_line() {
    let block = |line, language: &str, text: &str| Block {
        line,
        language: language.into(),
        text: text.into(),
    };
    assert_eq!(
        blocks("a\n```toml\nb = 1\n```\nc\n```\nd\n```\n"),
        [block(3, "toml", "b = 1\n"), block(7, "", "d\n")]
    );
}

#[test]
fn links_and_anchors_are_found() {
    let page = "# One & two's `x`\n[a](b.md#c) and ![d](e.png)\n```\n[no](no.md)\n```\n";
    assert_eq!(
        links(page),
        [(2, "b.md#c".to_owned()), (2, "e.png".to_owned())]
    );
    assert_eq!(anchors(page), ["one--twos-x"]);
}
