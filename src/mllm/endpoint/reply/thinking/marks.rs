//! The marks around reasoning of models and servers, and whether a text begins with one.

/// Names of tags around reasoning: Qwen, `DeepSeek` and others; variants; `EXAONE` and Marco;
/// Seed-OSS, `MiniMax`, `LongCat`, Hunyuan, K2 Horizon.
static NAMES: [&str; 15] = [
    "think",
    "thinking",
    "thought",
    "thoughts",
    "reasoning",
    "antthinking",
    "scratchpad",
    "seed:think",
    "mm:think",
    "longcat_think",
    "think:opensource",
    "ifm|think",
    "ifm|think_fast",
    "ifm|think_faster",
    "inner_monologue",
];
/// Names of tags that an answer may have too, so they count only at its beginning and before text.
static WEAK_NAMES: [&str; 3] = ["reason", "analysis", "reflection"];
/// The tag of Open `WebUI`, and the attribute that makes it one of reasoning.
static DETAILS: (&str, &str) = ("details", "type=\"reasoning\"");
/// Longest attributes of a tag, bytes.
const MAX_ATTRIBUTES: usize = 200;

/// Other marks, which are pairs of fixed texts.
#[derive(Debug, PartialEq)]
pub(super) struct Pair {
    begin: &'static str,
    ends: &'static [&'static str],
    /// Whether the end says that reasoning came before it, also where the beginning is absent.
    alone: bool,
}

const fn pair(begin: &'static str, ends: &'static [&'static str]) -> Pair {
    Pair {
        begin,
        ends,
        alone: true,
    }
}

const fn together(begin: &'static str, ends: &'static [&'static str]) -> Pair {
    Pair {
        begin,
        ends,
        alone: false,
    }
}

/// What follows the reasoning of gpt-oss, whose end some servers lose.
const AFTER_CHANNEL: &[&str] = &[
    "<|end|>",
    "<|call|>",
    "<|start|>assistant",
    "<|channel|>final",
];
/// Mistral; Kimi; Kimi K3; Command A; `OpenThoughts`; `MiniCPM`; Apertus; `MedGemma`; Pangu; Gemma 4;
/// Solar Open; others; the channels of gpt-oss: two of reasoning, and the head of the answer; a
/// model whose channels are recipients; `HyperCLOVA`.
static PAIRS: [Pair; 21] = [
    pair("[THINK]", &["[/THINK]"]),
    pair("[REASONING]", &["[/REASONING]"]),
    pair("◁think▷", &["◁/think▷"]),
    pair("<|open|>think<|sep|>", &["<|close|>think<|sep|>"]),
    pair("<|START_THINKING|>", &["<|END_THINKING|>"]),
    pair("<|begin_of_thought|>", &["<|end_of_thought|>"]),
    pair("<|thought_start|>", &["<|thought_end|>"]),
    pair("<|inner_prefix|>", &["<|inner_suffix|>"]),
    pair("<unused94>", &["<unused95>"]),
    pair("[unused16]", &["[unused17]"]),
    pair("<|channel>thought", &["<channel|>"]),
    pair("<|think:start|>", &["<|think:end|>"]),
    pair("<|thinking|>", &["<|/thinking|>"]),
    pair("<|reasoning|>", &["<|/reasoning|>"]),
    together("<|think|>", &["<|/think|>", "<|end|>"]),
    together("<|channel|>analysis", AFTER_CHANNEL),
    together("<|channel|>commentary", AFTER_CHANNEL),
    together("<|channel|>final", &["<|message|>"]),
    together("<|constrain|>", &["<|message|>"]),
    together("to=self<|message|>", &["<|eom|>"]),
    together("/think\n", &["<|im_start|>assistant"]),
];
/// The ends of pairs that an answer begins behind, though they are no end of reasoning.
const BEGINS_OF_ANSWERS: [&str; 1] = ["<|channel|>final"];

/// Marks before an answer, which belong to the prompt: `ChatML`, Gemma, Llama 3 and 4, Granite,
/// Mistral, EXAONE, gpt-oss, Phi and GLM, `DeepSeek`, Seed-OSS, Command A, Kimi K3, Solar Open, the beginnings of texts, and marks
/// around an answer.
const HEADS: [&str; 32] = [
    "<|im_start|>assistant",
    "<start_of_turn>model",
    "<|turn>model",
    "<|start_header_id|>assistant<|end_header_id|>",
    "<|header_start|>assistant<|header_end|>",
    "<|start_of_role|>assistant<|end_of_role|>",
    "[/INST]",
    "[|assistant|]",
    "<|start|>assistant",
    "<|message|>",
    "to=user<|message|>",
    "<|assistant|>",
    "<｜Assistant｜>",
    "<seed:bos>assistant",
    "<|START_OF_TURN_TOKEN|>",
    "<|CHATBOT_TOKEN|>",
    "<|START_RESPONSE|>",
    "<|START_TEXT|>",
    "<|open|>response<|sep|>",
    "<|begin|>assistant",
    "<|content|>",
    "<|begin_of_text|>",
    "<｜begin▁of▁sentence｜>",
    "<s>",
    "<bos>",
    "<answer>",
    "<response>",
    "<output>",
    "<CONCLUSION>",
    "<|begin_of_box|>",
    "<|begin_of_solution|>",
    "<longcat_assistant>",
];
/// Characters that marks inside a text begin with.
pub(super) const FIRST: [char; 3] = ['<', '[', '◁'];

/// A mark of reasoning whose beginning was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Mark {
    Tag(&'static str),
    Pair(&'static Pair),
}

impl Mark {
    /// Whether an answer may have this mark too.
    pub(super) fn is_weak(self) -> bool {
        matches!(self, Self::Tag(name) if WEAK_NAMES.contains(&name))
    }

    /// Whether a text begins with a further beginning of this mark, or with its end.
    pub(super) fn step(self, text: &str) -> Seen<Step> {
        match self {
            Self::Tag(name) => match tag(text) {
                Seen::Yes(found, length) if found.name == name => match found.form {
                    Form::Opens => Seen::Yes(Step::Deeper, length),
                    Form::Closes => Seen::Yes(Step::End, length),
                    Form::Empty => Seen::No,
                },
                Seen::Maybe => Seen::Maybe,
                _ => Seen::No,
            },
            Self::Pair(pair) => {
                let begin = std::iter::once((pair.begin, Step::Deeper));
                let ends = pair.ends.iter().map(|end| (*end, Step::End));
                begin
                    .chain(ends)
                    .map(|(mark, step)| fixed(text, mark).with(step))
                    .fold(Seen::No, Seen::or)
            }
        }
    }
}

/// What a text inside of reasoning begins with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Step {
    Deeper,
    End,
}

/// What a text begins with, and its length, bytes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Seen<T> {
    No,
    /// The text is the beginning of it.
    Maybe,
    Yes(T, usize),
}

impl<T> Seen<T> {
    fn with<U>(self, value: U) -> Seen<U> {
        match self {
            Self::No => Seen::No,
            Self::Maybe => Seen::Maybe,
            Self::Yes(_, length) => Seen::Yes(value, length),
        }
    }

    /// The surer of two.
    fn or(self, other: Self) -> Self {
        match (self, other) {
            (yes @ Self::Yes(..), _) | (_, yes @ Self::Yes(..)) => yes,
            (Self::Maybe, _) | (_, Self::Maybe) => Self::Maybe,
            _ => Self::No,
        }
    }
}

/// What stands before an answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Before {
    /// A mark of the prompt, or reasoning that is empty.
    Head,
    Reasoning(Mark),
}

/// What a text has before its answer.
pub(super) fn before_answer(text: &str) -> Seen<Before> {
    let heads = HEADS
        .iter()
        .map(|head| fixed(text, head).with(Before::Head));
    let pairs = PAIRS
        .iter()
        .map(|pair| fixed(text, pair.begin).with(Before::Reasoning(Mark::Pair(pair))));
    heads.chain(pairs).fold(begin_of_tag(text, true), Seen::or)
}

/// What an answer has inside, where it is no mention of a mark.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Inside {
    Reasoning(Mark),
    /// What came before was reasoning.
    EndAlone,
}

/// What a text inside of an answer begins with.
pub(super) fn in_answer(text: &str) -> Seen<Inside> {
    let begins = PAIRS
        .iter()
        .filter(|pair| pair.alone)
        .map(|pair| fixed(text, pair.begin).with(Inside::Reasoning(Mark::Pair(pair))));
    let alone = PAIRS.iter().filter(|pair| pair.alone);
    let ends = alone
        .flat_map(|pair| pair.ends)
        .map(|end| fixed(text, end).with(Inside::EndAlone));
    // The head of an answer is read where the answer begins.
    let answers = BEGINS_OF_ANSWERS
        .iter()
        .map(|begin| match fixed(text, begin) {
            Seen::Yes((), _) => Seen::Yes(Inside::EndAlone, 0),
            seen => seen.with(Inside::EndAlone),
        });
    let tags = match tag(text) {
        Seen::Yes(found, length) if found.form == Form::Closes && NAMES.contains(&found.name) => {
            Seen::Yes(Inside::EndAlone, length)
        }
        Seen::Maybe => Seen::Maybe,
        _ => match begin_of_tag(text, false) {
            Seen::Yes(Before::Reasoning(mark), length) => {
                Seen::Yes(Inside::Reasoning(mark), length)
            }
            Seen::Maybe => Seen::Maybe,
            _ => Seen::No,
        },
    };
    begins.chain(ends).chain(answers).fold(tags, Seen::or)
}

fn begin_of_tag(text: &str, weak: bool) -> Seen<Before> {
    match tag(text) {
        Seen::Yes(found, length)
            if found.is_meant && (weak || !WEAK_NAMES.contains(&found.name)) =>
        {
            match found.form {
                Form::Opens => Seen::Yes(Before::Reasoning(Mark::Tag(found.name)), length),
                Form::Empty => Seen::Yes(Before::Head, length),
                Form::Closes => Seen::No,
            }
        }
        Seen::Maybe => Seen::Maybe,
        _ => Seen::No,
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Tag {
    name: &'static str,
    form: Form,
    /// Whether its attributes make it one of reasoning.
    is_meant: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Form {
    Opens,
    Closes,
    /// Both at once.
    Empty,
}

/// The tag that a text begins with, in letters of any case and with any attributes.
fn tag(text: &str) -> Seen<Tag> {
    let Some(inner) = text.strip_prefix('<') else {
        return if text.is_empty() {
            Seen::Maybe
        } else {
            Seen::No
        };
    };
    let (inner, closes) = inner
        .strip_prefix('/')
        .map_or((inner, false), |inner| (inner, true));
    let is_of_name = |c: char| c.is_ascii_alphanumeric() || matches!(c, ':' | '_' | '|');
    let length = inner.find(|c| !is_of_name(c)).unwrap_or(inner.len());
    let (name, rest) = inner.split_at_checked(length).unwrap_or((inner, ""));
    let plain = name.to_ascii_lowercase();
    let mut known = NAMES.iter().chain(&WEAK_NAMES).chain([&DETAILS.0]);
    if rest.is_empty() {
        return if known.any(|known| known.starts_with(&plain)) {
            Seen::Maybe
        } else {
            Seen::No
        };
    }
    let Some(&name) = known.find(|known| **known == plain) else {
        return Seen::No;
    };
    // A tag without an end is not looked for in all that follows.
    let near = rest.floor_char_boundary(MAX_ATTRIBUTES + 1);
    let near = rest.get(..near).unwrap_or(rest);
    let end = near.find('>');
    let attributes = end.map_or(near, |end| near.get(..end).unwrap_or(near));
    let fits = attributes.len() <= MAX_ATTRIBUTES
        && !attributes.contains('<')
        && (attributes.is_empty() || attributes.starts_with(['/', ' ', '\t', '\n']));
    let is_meant = name != DETAILS.0 || closes || attributes.contains(DETAILS.1);
    match end {
        _ if !fits => Seen::No,
        None => Seen::Maybe,
        Some(end) => {
            let form = match (closes, attributes.ends_with('/')) {
                (true, _) => Form::Closes,
                (false, true) => Form::Empty,
                (false, false) => Form::Opens,
            };
            Seen::Yes(
                Tag {
                    name,
                    form,
                    is_meant,
                },
                text.len() - rest.len() + end + 1,
            )
        }
    }
}

/// Whether a text begins with a mark, in letters of any case.
fn fixed(text: &str, mark: &str) -> Seen<()> {
    let length = mark.len().min(text.len());
    let same = text
        .as_bytes()
        .iter()
        .zip(mark.as_bytes())
        .all(|(one, other)| one.eq_ignore_ascii_case(other));
    match same {
        true if length == mark.len() => Seen::Yes((), length),
        true => Seen::Maybe,
        false => Seen::No,
    }
}
