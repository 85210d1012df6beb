//! Reasoning inside the content, between marks: what a server sends that does not take it out. And
//! the marks of a chat template before the answer.

mod marks;
mod words;

use super::marks::bare;
use marks::{Before, FIRST, Inside, Mark, Seen, Step, before_answer, in_answer};
use words::Words;

/// Signs on both sides of a mark that is mentioned and not used.
const QUOTES: [char; 6] = ['`', '"', '\'', '“', '”', '’'];
/// The tag around an answer whose reasoning has no marks.
const AROUND: (&str, &str) = ("<answer>", "</answer>");

/// Finds the answer in a content, whether it comes whole or in pieces.
#[derive(Debug, Default)]
pub(super) struct Reader {
    content: String,
    /// Bytes of the content that are decided.
    at: usize,
    place: Place,
    answer: String,
    /// Where the first answer begins in the content, bytes.
    begin: Option<usize>,
    /// Whether reasoning was seen.
    reasoned: bool,
    /// Whether all marks of reasoning so far are such as answers have too.
    weak: bool,
    /// Whether what stood in the place of the answer was reasoning.
    restarted: bool,
}

/// Where a reader is.
#[derive(Debug, Clone, Copy, Default)]
enum Place {
    /// Before an answer.
    #[default]
    Start,
    Reasoning(Open),
    Worded(Worded),
    Answer,
}

/// Reasoning whose end was not seen.
#[derive(Debug, Clone, Copy)]
struct Open {
    mark: Mark,
    /// How many beginnings lack their ends.
    depth: usize,
    /// Where its beginning stands, bytes.
    from: usize,
    /// Where an end stops that was not the last one, bytes.
    end: Option<usize>,
    /// Whether an answer has begun before it.
    within: bool,
}

/// Reasoning between words.
#[derive(Debug, Clone, Copy)]
struct Worded {
    words: &'static Words,
    /// Where the search for its end goes on, bytes.
    scanned: usize,
}

/// The answer in a content that is complete.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Found {
    pub(super) text: String,
    /// Whether the content has reasoning.
    pub(super) reasoned: bool,
}

impl Reader {
    /// Adds a piece of the content.
    pub(super) fn push(&mut self, piece: &str) {
        self.content.push_str(piece);
        self.advance(false);
    }

    /// The content so far.
    pub(super) fn content(&self) -> &str {
        &self.content
    }

    /// What is known of the answer so far. None of it is reasoning, unless an end of reasoning
    /// without its beginning comes.
    pub(super) fn known(&self) -> Option<&str> {
        (!self.restarted).then_some(self.answer.as_str())
    }

    /// The answer, once the content is complete.
    pub(super) fn finish(mut self) -> Found {
        loop {
            self.advance(true);
            match self.place {
                Place::Reasoning(open) => match (open.end, open.within) {
                    // The reasoning mentions its own beginning.
                    (Some(end), _) => self.leave(end, open.within),
                    (None, true) => {
                        self.at = open.from;
                        self.keep(self.rest().len());
                        break;
                    }
                    (None, false) => {
                        self.begin = None;
                        break;
                    }
                },
                // Blanks, which are an answer where nothing else is.
                Place::Start => {
                    if self.at == 0 {
                        self.keep(self.content.len());
                    }
                    break;
                }
                Place::Worded(_) | Place::Answer => break,
            }
        }
        let text = self.text();
        Found {
            text,
            reasoned: self.reasoned,
        }
    }

    /// The text of the answer at the end of the content.
    fn text(&mut self) -> String {
        let is_blank = self.answer.trim().is_empty();
        if is_blank && self.reasoned && self.weak {
            // Tags of an answer, and not of reasoning.
            self.reasoned = false;
            return self.content.trim_start().to_owned();
        }
        if is_blank
            && self.restarted
            && let Some(first) = self.begin
        {
            self.reasoned = false;
            return self.rest_from(first).to_owned();
        }
        if let Some((_, inside)) = self.answer.rsplit_once(AROUND.0)
            && inside.contains(AROUND.1)
            && let answer = bare(inside)
            && !answer.contains(AROUND.1)
            && !answer.trim().is_empty()
        {
            self.reasoned = true;
            return answer.trim_start().to_owned();
        }
        std::mem::take(&mut self.answer)
    }

    fn rest(&self) -> &str {
        self.rest_from(self.at)
    }

    fn rest_from(&self, from: usize) -> &str {
        self.content
            .get(from..)
            .expect("places in the content lie between characters")
    }

    /// Decides what can be decided; `ended` says that nothing follows.
    fn advance(&mut self, ended: bool) {
        loop {
            let moved = match self.place {
                Place::Start => self.start(ended),
                Place::Reasoning(open) => self.reason(open, ended),
                Place::Worded(worded) => self.worded(worded, ended),
                Place::Answer => self.say(ended),
            };
            if !moved {
                break;
            }
        }
    }

    /// Reads what stands before an answer; `false` where more of the content is needed.
    fn start(&mut self, ended: bool) -> bool {
        let rest = self.rest();
        let text = rest.trim_start();
        let from = self.content.len() - text.len();
        if text.is_empty() {
            return false;
        }
        if let Some(words) = words::begun(text) {
            self.at = from;
            self.place = Place::Worded(Worded {
                words,
                scanned: from,
            });
            return true;
        }
        if let Seen::Yes((), length) = words::format(text) {
            self.at = from + length;
            return true;
        }
        match before_answer(text) {
            Seen::Yes(Before::Head, length) => self.at = from + length,
            Seen::Yes(Before::Reasoning(mark), length) => {
                self.weak = mark.is_weak() && (self.weak || !self.reasoned);
                self.reasoned = true;
                self.begin = None;
                self.open(mark, from, from + length, false);
            }
            _ if !ended && is_undecided(text) => return false,
            _ => {
                // Blanks before an answer without marks are part of it.
                if self.at > 0 {
                    self.at = from;
                }
                self.begin.get_or_insert(self.at);
                self.place = Place::Answer;
            }
        }
        true
    }

    fn open(&mut self, mark: Mark, from: usize, at: usize, within: bool) {
        self.at = at;
        self.place = Place::Reasoning(Open {
            mark,
            depth: 1,
            from,
            end: None,
            within,
        });
    }

    /// Goes on behind reasoning.
    fn leave(&mut self, end: usize, within: bool) {
        self.at = end;
        self.place = if within { Place::Answer } else { Place::Start };
    }

    /// Looks for the end of reasoning.
    fn reason(&mut self, mut open: Open, ended: bool) -> bool {
        let decided = loop {
            let Some(next) = self.rest().find(FIRST) else {
                break self.content.len();
            };
            self.at += next;
            let text = self.rest();
            let (step, length) = match open.mark.step(text) {
                Seen::Maybe if !ended => break self.at,
                Seen::Yes(_, length) if !ended && self.may_be_mention(length) => break self.at,
                Seen::Yes(step, length) if !self.is_mention(length) => (step, length),
                _ => {
                    self.at += text.chars().next().map_or(1, char::len_utf8);
                    continue;
                }
            };
            self.at += length;
            // An inner beginning may be a mention, so the last end before the outer one is kept.
            match step {
                Step::Deeper => open.depth += 1,
                Step::End if open.depth > 1 => {
                    open.depth -= 1;
                    open.end = Some(self.at);
                }
                Step::End => {
                    self.reasoned = true;
                    self.leave(self.at, open.within);
                    return true;
                }
            }
        };
        self.at = decided;
        self.place = Place::Reasoning(open);
        false
    }

    /// Looks for the words behind reasoning between words.
    fn worded(&mut self, worded: Worded, ended: bool) -> bool {
        let Worded { words, scanned } = worded;
        let from = self.content.floor_char_boundary(scanned);
        if let Some((at, length)) = words.end(self.rest_from(from)) {
            self.reasoned = true;
            self.at = from + at + length;
            self.place = Place::Start;
            return true;
        }
        if !ended {
            let scanned = self.content.len().saturating_sub(words::MAX_END);
            let scanned = scanned.max(self.at);
            self.place = Place::Worded(Worded { words, scanned });
            return false;
        }
        if words::are_clear(self.rest()) {
            self.reasoned = true;
            self.at = self.content.len();
            self.place = Place::Start;
        } else {
            self.begin.get_or_insert(self.at);
            self.place = Place::Answer;
        }
        true
    }

    /// Takes the answer over up to the next mark.
    fn say(&mut self, ended: bool) -> bool {
        let rest = self.rest();
        let mark = rest.find(FIRST);
        let plain = mark.map_or(rest, |mark| rest.get(..mark).unwrap_or(rest));
        let word = words::end_alone(plain, self.last(), mark.is_none() && !ended);
        let Some(next) = word.map(|(at, _)| at).or(mark) else {
            self.keep(rest.len());
            return false;
        };
        self.keep(next);
        let text = self.rest();
        let seen = word.map_or_else(|| in_answer(text), |(_, seen)| seen);
        let step = match seen {
            Seen::Maybe if !ended => return false,
            Seen::Yes(_, length) if !ended && self.may_be_mention(length) => return false,
            Seen::Yes(inside, length) if !self.is_mention(length) => (inside, length),
            _ => {
                self.keep(text.chars().next().map_or(0, char::len_utf8));
                return true;
            }
        };
        match step {
            (Inside::EndAlone, length) => self.restart(length),
            (Inside::Reasoning(mark), length) if self.is_set_off() => {
                self.open(mark, self.at, self.at + length, true);
            }
            (Inside::Reasoning(_), length) => self.keep(length),
        }
        true
    }

    /// Takes bytes of the content over into the answer.
    fn keep(&mut self, length: usize) {
        let (from, to) = (self.at, self.at + length);
        let kept = self
            .content
            .get(from..to)
            .expect("places in the content lie between characters");
        self.answer.push_str(kept);
        self.at = to;
    }

    /// Drops the answer so far, which was reasoning.
    fn restart(&mut self, length: usize) {
        self.answer.clear();
        self.restarted = true;
        self.reasoned = true;
        self.weak = false;
        self.leave(self.at + length, false);
    }

    /// The last decided character.
    fn last(&self) -> Option<char> {
        self.content.get(..self.at)?.chars().next_back()
    }

    /// Whether only what follows a mark of this length shows whether it is a mention.
    fn may_be_mention(&self, length: usize) -> bool {
        self.at + length >= self.content.len()
            && self.last().is_some_and(|last| QUOTES.contains(&last))
    }

    /// Whether a mark of this length stands in quotes.
    fn is_mention(&self, length: usize) -> bool {
        let next = self.rest_from(self.at + length).chars().next();
        [self.last(), next]
            .iter()
            .all(|side| side.is_some_and(|side| QUOTES.contains(&side)))
    }

    /// Whether a mark here is no word of a sentence.
    fn is_set_off(&self) -> bool {
        self.last()
            .is_none_or(|last| last == '\n' || !last.is_whitespace() && !QUOTES.contains(&last))
    }
}

/// Whether a text before an answer may be the beginning of something else.
fn is_undecided(text: &str) -> bool {
    before_answer(text) == Seen::Maybe
        || words::may_begin(text)
        || words::format(text) == Seen::Maybe
}

#[cfg(test)]
mod tests;
