//! The names of the variables of templates, for a set that names others. `variables` gives their
//! values; a test holds both equal.

/// Those of a template of a prompt set; those of a map with its name before a point.
pub(super) fn of_template(template: &str) -> &'static [&'static str] {
    match template {
        "system" => &[
            "function",
            "legend",
            "ranges.v0",
            "ranges.acc",
            "ranges.dec",
        ],
        "feedback" => &["code", "score", "threshold", "parts", "errors"],
        // The rounds.
        _ => &["scene_text", "feedback", "centerlines", "leaders"],
    }
}

/// Those of a template of a question outside the rounds.
pub(super) fn of_question(set: &str, template: &str) -> &'static [&'static str] {
    match (set, template) {
        ("ask", _) => &["compact", "question", "scene_text", "legend"],
        (_, "system") => &["compact", "signature"],
        _ => &["compact", "scene_text", "score", "feedback"],
    }
}
