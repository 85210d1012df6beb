//! Which functions and constants of a source file have a comment, read off its lines as `rustfmt`
//! lays them out.

/// A function with a body, by its lines from 0: that of its name, and that of its last brace.
struct Function<'a> {
    name: &'a str,
    first: usize,
    last: usize,
}

/// The functions longer than `max` lines, with their first line from 1, whose body has no comment.
/// Doc comments of items inside do not count: they belong to these items.
pub(super) fn unexplained_functions(
    text: &str,
    is_code: &dyn Fn(usize) -> bool,
    max: usize,
) -> Vec<(usize, String)> {
    let lines: Vec<&str> = text.lines().collect();
    let explained = |function: &Function<'_>| {
        lines[function.first..=function.last]
            .iter()
            .map(|line| line.trim_start())
            .any(|line| line.starts_with("//") && !line.starts_with("///"))
    };
    (0..lines.len())
        .filter(|&number| is_code(number + 1))
        .filter_map(|number| function(&lines, number))
        .filter(|function| function.last - function.first + 1 > max && !explained(function))
        .map(|function| (function.first + 1, function.name.to_owned()))
        .collect()
}

/// The function that begins in a line.
fn function<'a>(lines: &[&'a str], first: usize) -> Option<Function<'a>> {
    let line = lines[first];
    let (indent, code) = line.split_at(line.len() - line.trim_start().len());
    let words: Vec<&str> = code.split("fn ").collect();
    let [before, after, ..] = words.as_slice() else {
        return None;
    };
    let is_head = |word: &str| {
        word.starts_with("pub")
            || word.starts_with("in ")
            || word.ends_with(')')
            || ["const", "async", "unsafe", "extern", "\"C\""].contains(&word)
    };
    if !before.split_whitespace().all(is_head) {
        return None;
    }
    let name = after.split(['(', '<']).next()?;
    // A method that a trait declares ends with a semicolon before any brace opens.
    let opens = (first..lines.len()).find(|&number| lines[number].ends_with(['{', ';', '}']))?;
    if !lines[opens].ends_with('{') {
        return None;
    }
    let last = (opens + 1..lines.len())
        .find(|&number| lines[number].strip_prefix(indent) == Some("}"))
        .expect("the last brace of a function stands at the column of its first word");
    Some(Function { name, first, last })
}

/// The constants that hold numbers or times, with their line from 1, that have no comment of their
/// own or of the constant right above them. Those of an implementation stand in its trait.
pub(super) fn unexplained_numbers(
    text: &str,
    is_code: &dyn Fn(usize) -> bool,
) -> Vec<(usize, String)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    let mut in_implementation = false;
    // Whether the line above belongs to a constant that has a comment.
    let mut explained = false;
    let mut number = 0;
    while let Some(line) = lines.get(number) {
        if line.starts_with("impl") || line.starts_with('}') {
            in_implementation = line.starts_with("impl") && line.contains(" for ");
        }
        let code = line.trim_start();
        if let Some((name, kind)) = constant(code).filter(|_| is_code(number + 1)) {
            let is_of_trait = in_implementation && line.starts_with("    const ");
            if holds_numbers(kind) && !explained && !is_of_trait {
                found.push((number + 1, name.to_owned()));
            }
            number += lines[number..]
                .iter()
                .position(|line| line.ends_with(';'))
                .unwrap_or(0);
        } else {
            explained = code.starts_with("//") || (explained && code.starts_with("#["));
        }
        number += 1;
    }
    found
}

/// The name of a constant, and its type with its value.
fn constant(code: &str) -> Option<(&str, &str)> {
    let code = match code.strip_prefix("pub") {
        Some(rest) => rest.split_once("const ")?.1,
        None => code.strip_prefix("const ")?,
    };
    let (name, kind) = code.split_once(": ")?;
    let is_name = |c: char| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_';
    name.chars().all(is_name).then_some((name, kind))
}

fn holds_numbers(kind: &str) -> bool {
    const NUMBERS: [&str; 15] = [
        "f32", "f64", "u8", "u16", "u32", "u64", "u128", "usize", "i8", "i16", "i32", "i64",
        "isize", "Duration", "Rgb",
    ];
    let kind = kind.trim_start_matches(['&', '[', '(']);
    let word = kind.split([' ', ';', ',', '=', ')', ']']).next();
    word.is_some_and(|word| NUMBERS.contains(&word))
}

#[test]
fn functions_and_constants_without_a_comment_are_found() {
    let any = |_: usize| true;
    let text = "\
fn short() {\n    a\n}
pub(crate) fn long<T>(\n    a: T,\n) -> T {\n    /// Meters.\n    const B: f64 = 1.0;\n    a\n}
impl A for B {\n    const C: usize = 3;\n    fn explained(&self) {\n        // Because.\n        b\n    }
    fn declared(\n        &self,\n    ) -> u8;\n}
";
    let found = unexplained_functions(text, &any, 3);
    assert_eq!(found, [(4, "long".to_owned())]);
    assert_eq!(unexplained_functions(text, &any, 7), []);
    assert_eq!(unexplained_functions(text, &|line| line != 4, 3), []);
    let text = "\
/// Meters.\nconst A: f64 = 1.0;\nconst B: [f64; 2] = [\n    1.0,\n];
const NAME: &str = \"x\";\n\npub(super) const C: Duration = D;
";
    assert_eq!(unexplained_numbers(text, &any), [(8, "C".to_owned())]);
    assert_eq!(
        unexplained_numbers("impl A {\n    pub const C: u8 = 3;\n}", &any),
        [(2, "C".to_owned())]
    );
    assert_eq!(
        unexplained_numbers("impl A for B {\n    const C: u8 = 3;\n}", &any),
        []
    );
}
