//! Reads the structure of a PyTorch file. It is a program for Python's pickle machine; this machine
//! knows dictionaries, lists and tensors. Everything else, classes and calls of functions among it,
//! becomes [`Value::Opaque`] and is never run.
//!
//! Not candle's reader. That one indexes into the file's tuples without a check, and rejects
//! protocol 4. It copies what a file refers to several times, so few bytes can fill the memory.
//! Here, values lie in one list and refer to each other by number.

use std::collections::HashMap;
use std::rc::Rc;

/// Longest name of a tensor, bytes; longer ones are no PyTorch names.
const MAX_NAME_BYTES: usize = 512;
/// Maximum number of tensors of a file, and of dimensions of one.
const MAX_TENSORS: usize = 1 << 16;
const MAX_RANK: usize = 8;

/// Why a pickle cannot be read.
#[derive(Debug, thiserror::Error)]
pub(super) enum PickleError {
    #[error("ends too early")]
    Truncated,
    #[error("has the unknown instruction {code:#04x} at byte {at}")]
    Instruction { code: u8, at: usize },
    #[error("takes more values than it has, at byte {0}")]
    EmptyStack(usize),
    #[error("names a value that it did not keep, at byte {0}")]
    NotKept(usize),
    #[error("has a text that is no UTF-8, at byte {0}")]
    Text(usize),
}

/// What a storage holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Element {
    F32,
    F64,
    F16,
    Bf16,
    I64,
    I32,
    U8,
}

impl Element {
    fn from_class(class: &str) -> Option<Self> {
        Some(match class {
            "FloatStorage" => Self::F32,
            "DoubleStorage" => Self::F64,
            "HalfStorage" => Self::F16,
            "BFloat16Storage" => Self::Bf16,
            "LongStorage" => Self::I64,
            "IntStorage" => Self::I32,
            "ByteStorage" | "BoolStorage" => Self::U8,
            _ => return None,
        })
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Self::F64 | Self::I64 => 8,
            Self::F32 | Self::I32 => 4,
            Self::F16 | Self::Bf16 => 2,
            Self::U8 => 1,
        }
    }
}

/// Where the numbers of a tensor are; offset and strides count numbers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct TensorPlace {
    pub(super) storage: Rc<str>,
    pub(super) element: Element,
    pub(super) offset: usize,
    pub(super) shape: Vec<usize>,
    pub(super) strides: Vec<usize>,
}

impl TensorPlace {
    /// Its numbers; `None` where they cannot be counted.
    pub(super) fn count(&self) -> Option<usize> {
        self.shape
            .iter()
            .try_fold(1usize, |count, length| count.checked_mul(*length))
    }
}

/// The place of a value in [`Pickle::values`].
type Id = usize;

#[derive(Debug, Clone)]
enum Value {
    Opaque,
    Int(i64),
    Text(Rc<str>),
    Class { module: Rc<str>, name: Rc<str> },
    Tuple(Vec<Id>),
    List(Vec<Id>),
    Dict(Vec<(Id, Id)>),
    Storage { element: Element, key: Rc<str> },
    Tensor(TensorPlace),
}

/// A structure that was read.
#[derive(Debug)]
pub(super) struct Pickle {
    values: Vec<Value>,
    root: Id,
}

impl Pickle {
    pub(super) fn read(bytes: &[u8]) -> Result<Self, PickleError> {
        let mut machine = Machine {
            bytes,
            at: 0,
            values: Vec::new(),
            stack: Vec::new(),
            marks: Vec::new(),
            memo: HashMap::new(),
        };
        let root = machine.run()?;
        Ok(Self {
            values: machine.values,
            root,
        })
    }

    /// The tensors of the state dictionary: those under `state_dict`, if there is one, else all of
    /// the outer dictionary and of the dictionaries in it, whose keys then stand before the names.
    pub(super) fn state(&self) -> Vec<(String, TensorPlace)> {
        let state = self
            .entries(self.root)
            .find(|(key, _)| *key == "state_dict")
            .map_or(self.root, |(_, state)| state);
        let mut found = Vec::new();
        for (name, value) in self.entries(state) {
            if found.len() > MAX_TENSORS {
                break;
            }
            if let Some(place) = self.tensor(value) {
                found.push((name.to_owned(), place.clone()));
            }
            let inner = self
                .entries(value)
                .filter_map(|(part, value)| Some((part, self.tensor(value)?)))
                .take(MAX_TENSORS);
            found.extend(inner.map(|(part, place)| (format!("{name}.{part}"), place.clone())));
        }
        found
    }

    fn entries(&self, id: Id) -> impl Iterator<Item = (&str, Id)> {
        let entries = match self.values.get(id) {
            Some(Value::Dict(entries)) => entries.as_slice(),
            _ => &[],
        };
        entries
            .iter()
            .filter_map(|&(key, value)| match self.values.get(key) {
                Some(Value::Text(key)) if key.len() <= MAX_NAME_BYTES => {
                    Some((key.as_ref(), value))
                }
                _ => None,
            })
    }

    fn tensor(&self, id: Id) -> Option<&TensorPlace> {
        match self.values.get(id)? {
            Value::Tensor(place) => Some(place),
            _ => None,
        }
    }
}

/// The machine while it runs.
struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    values: Vec<Value>,
    stack: Vec<Id>,
    /// Heights of the stack that a later instruction goes back to.
    marks: Vec<usize>,
    memo: HashMap<usize, Id>,
}

impl Machine<'_> {
    #[allow(clippy::too_many_lines, reason = "one arm an instruction")]
    fn run(&mut self) -> Result<Id, PickleError> {
        loop {
            let at = self.at;
            match self.take::<1>()?[0] {
                b'.' => return self.pop(),
                0x80 => {
                    self.take::<1>()?;
                }
                0x95 => {
                    self.take::<8>()?;
                }
                b'(' => self.marks.push(self.stack.len()),
                // The state of an object is not needed; the object stays.
                b'0' | b'b' => {
                    self.pop()?;
                }
                b'1' | 0x90 => {
                    self.pop_to_mark()?;
                }
                b'2' => self
                    .stack
                    .push(*self.stack.last().ok_or(PickleError::EmptyStack(at))?),
                b'N' | 0x88 | 0x89 | 0x8f => self.push(Value::Opaque),
                b'G' => {
                    self.take::<8>()?;
                    self.push(Value::Opaque);
                }
                b'J' => {
                    let int = i32::from_le_bytes(self.take()?);
                    self.push(Value::Int(int.into()));
                }
                b'K' => {
                    let [int] = self.take()?;
                    self.push(Value::Int(int.into()));
                }
                b'M' => {
                    let int = u16::from_le_bytes(self.take()?);
                    self.push(Value::Int(int.into()));
                }
                0x8a => {
                    let [length] = self.take()?;
                    self.long(length.into())?;
                }
                0x8b => {
                    let length = u32::from_le_bytes(self.take()?);
                    self.long(length as usize)?;
                }
                0x8c => {
                    let [length] = self.take()?;
                    self.text(length.into())?;
                }
                b'X' => {
                    let length = u32::from_le_bytes(self.take()?);
                    self.text(length as usize)?;
                }
                0x8d => {
                    let length = u64::from_le_bytes(self.take()?);
                    self.text(usize::try_from(length).map_err(|_| PickleError::Truncated)?)?;
                }
                b'C' | b'U' => {
                    let [length] = self.take()?;
                    self.skip(length.into())?;
                }
                b'B' | b'T' => {
                    let length = u32::from_le_bytes(self.take()?);
                    self.skip(length as usize)?;
                }
                0x8e | 0x96 => {
                    let length = u64::from_le_bytes(self.take()?);
                    self.skip(usize::try_from(length).map_err(|_| PickleError::Truncated)?)?;
                }
                b')' => self.push(Value::Tuple(Vec::new())),
                0x85..=0x87 => {
                    let count = usize::from(self.bytes[at] - 0x84);
                    let first = self
                        .stack
                        .len()
                        .checked_sub(count)
                        .ok_or(PickleError::EmptyStack(at))?;
                    let items = self.stack.split_off(first);
                    self.push(Value::Tuple(items));
                }
                b't' => {
                    let items = self.pop_to_mark()?;
                    self.push(Value::Tuple(items));
                }
                b']' => self.push(Value::List(Vec::new())),
                b'l' => {
                    let items = self.pop_to_mark()?;
                    self.push(Value::List(items));
                }
                b'a' => {
                    let item = self.pop()?;
                    self.append(vec![item])?;
                }
                b'e' => {
                    let items = self.pop_to_mark()?;
                    self.append(items)?;
                }
                b'}' => self.push(Value::Dict(Vec::new())),
                b'd' => {
                    let items = self.pop_to_mark()?;
                    self.push(Value::Dict(pairs(&items)));
                }
                b's' => {
                    let (value, key) = (self.pop()?, self.pop()?);
                    self.insert(&[key, value])?;
                }
                b'u' => {
                    let items = self.pop_to_mark()?;
                    self.insert(&items)?;
                }
                0x91 => {
                    self.pop_to_mark()?;
                    self.push(Value::Opaque);
                }
                b'q' => {
                    let [number] = self.take()?;
                    self.keep(number.into())?;
                }
                b'r' => {
                    let number = u32::from_le_bytes(self.take()?);
                    self.keep(number as usize)?;
                }
                0x94 => self.keep(self.memo.len())?,
                b'h' => {
                    let [number] = self.take()?;
                    self.recall(number.into())?;
                }
                b'j' => {
                    let number = u32::from_le_bytes(self.take()?);
                    self.recall(number as usize)?;
                }
                b'c' => {
                    let (module, name) = (self.line()?, self.line()?);
                    self.push(Value::Class { module, name });
                }
                0x93 => {
                    let (name, module) = (self.pop()?, self.pop()?);
                    let class = match (&self.values[module], &self.values[name]) {
                        (Value::Text(module), Value::Text(name)) => Value::Class {
                            module: module.clone(),
                            name: name.clone(),
                        },
                        _ => Value::Opaque,
                    };
                    self.push(class);
                }
                b'Q' => {
                    let id = self.pop()?;
                    let storage = self.storage(id).unwrap_or(Value::Opaque);
                    self.push(storage);
                }
                b'R' | 0x81 => {
                    let (arguments, callable) = (self.pop()?, self.pop()?);
                    self.call(callable, arguments);
                }
                0x92 => {
                    self.pop()?;
                    let (arguments, callable) = (self.pop()?, self.pop()?);
                    self.call(callable, arguments);
                }
                code => return Err(PickleError::Instruction { code, at }),
            }
        }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], PickleError> {
        let taken = self.slice(N)?;
        taken.try_into().map_err(|_| PickleError::Truncated)
    }

    fn slice(&mut self, length: usize) -> Result<&[u8], PickleError> {
        let end = self.at.checked_add(length).ok_or(PickleError::Truncated)?;
        let slice = self.bytes.get(self.at..end).ok_or(PickleError::Truncated)?;
        self.at = end;
        Ok(slice)
    }

    fn push(&mut self, value: Value) {
        self.stack.push(self.values.len());
        self.values.push(value);
    }

    fn pop(&mut self) -> Result<Id, PickleError> {
        let floor = self.marks.last().copied().unwrap_or(0);
        if self.stack.len() <= floor {
            return Err(PickleError::EmptyStack(self.at));
        }
        self.stack.pop().ok_or(PickleError::EmptyStack(self.at))
    }

    fn pop_to_mark(&mut self) -> Result<Vec<Id>, PickleError> {
        let height = self.marks.pop().ok_or(PickleError::EmptyStack(self.at))?;
        Ok(self.stack.split_off(height))
    }

    fn long(&mut self, length: usize) -> Result<(), PickleError> {
        let digits = self.slice(length)?;
        let value = match digits.len() {
            0..=8 => {
                let negative = digits.last().is_some_and(|byte| byte & 0x80 != 0);
                let mut whole = [if negative { 0xff } else { 0 }; 8];
                whole[..digits.len()].copy_from_slice(digits);
                Value::Int(i64::from_le_bytes(whole))
            }
            _ => Value::Opaque,
        };
        self.push(value);
        Ok(())
    }

    fn text(&mut self, length: usize) -> Result<(), PickleError> {
        let at = self.at;
        let text = std::str::from_utf8(self.slice(length)?)
            .map_err(|_| PickleError::Text(at))?
            .into();
        self.push(Value::Text(text));
        Ok(())
    }

    fn skip(&mut self, length: usize) -> Result<(), PickleError> {
        self.slice(length)?;
        self.push(Value::Opaque);
        Ok(())
    }

    fn line(&mut self) -> Result<Rc<str>, PickleError> {
        let at = self.at;
        let length = self.bytes[at..]
            .iter()
            .position(|&byte| byte == b'\n')
            .ok_or(PickleError::Truncated)?;
        let line = std::str::from_utf8(self.slice(length)?)
            .map_err(|_| PickleError::Text(at))?
            .into();
        self.at += 1;
        Ok(line)
    }

    fn append(&mut self, items: Vec<Id>) -> Result<(), PickleError> {
        let &last = self.stack.last().ok_or(PickleError::EmptyStack(self.at))?;
        if let Value::List(list) = &mut self.values[last] {
            list.extend(items);
        }
        Ok(())
    }

    fn insert(&mut self, items: &[Id]) -> Result<(), PickleError> {
        let &last = self.stack.last().ok_or(PickleError::EmptyStack(self.at))?;
        if let Value::Dict(entries) = &mut self.values[last] {
            entries.extend(pairs(items));
        }
        Ok(())
    }

    fn keep(&mut self, number: usize) -> Result<(), PickleError> {
        let &last = self.stack.last().ok_or(PickleError::EmptyStack(self.at))?;
        self.memo.insert(number, last);
        Ok(())
    }

    fn recall(&mut self, number: usize) -> Result<(), PickleError> {
        self.stack.push(
            *self
                .memo
                .get(&number)
                .ok_or(PickleError::NotKept(self.at))?,
        );
        Ok(())
    }

    /// A call: PyTorch's functions that make tensors and dictionaries are known, all others give an
    /// opaque value.
    fn call(&mut self, callable: Id, arguments: Id) {
        match self.made(callable, arguments) {
            Some(Made::New(value)) => self.push(value),
            Some(Made::Known(id)) => self.stack.push(id),
            None => self.push(Value::Opaque),
        }
    }

    fn made(&self, callable: Id, arguments: Id) -> Option<Made> {
        let Value::Class { module, name } = self.values.get(callable)? else {
            return None;
        };
        let arguments = self.tuple(arguments)?;
        match (module.as_ref(), name.as_ref()) {
            ("collections", "OrderedDict" | "defaultdict") => {
                Some(Made::New(Value::Dict(Vec::new())))
            }
            ("torch._utils", "_rebuild_tensor_v2") => self.rebuilt(arguments).map(Made::New),
            ("torch._utils", "_rebuild_parameter") => arguments.first().copied().map(Made::Known),
            // Function, type, the function's arguments, state.
            ("torch._tensor", "_rebuild_from_type_v2") => match arguments {
                [_, _, inner, ..] => self.rebuilt(self.tuple(*inner)?).map(Made::New),
                _ => None,
            },
            _ => None,
        }
    }

    /// Of storage, offset, shape and strides.
    fn rebuilt(&self, arguments: &[Id]) -> Option<Value> {
        let [storage, offset, shape, strides, ..] = arguments else {
            return None;
        };
        let Value::Storage { element, key } = self.values.get(*storage)? else {
            return None;
        };
        let sizes = |id: Id| {
            let sizes = self.tuple(id)?.iter();
            if sizes.len() > MAX_RANK {
                None
            } else {
                sizes
                    .map(|&size| self.size(size))
                    .collect::<Option<Vec<usize>>>()
            }
        };
        let (shape, strides) = (sizes(*shape)?, sizes(*strides)?);
        if shape.len() != strides.len() {
            return None;
        }
        let place = TensorPlace {
            storage: key.clone(),
            element: *element,
            offset: self.size(*offset)?,
            shape,
            strides,
        };
        Some(Value::Tensor(place))
    }

    /// Of "storage", its class, its key, a device and its length.
    fn storage(&self, id: Id) -> Option<Value> {
        let [_, class, key, ..] = self.tuple(id)? else {
            return None;
        };
        let (Value::Class { name, .. }, Value::Text(key)) =
            (self.values.get(*class)?, self.values.get(*key)?)
        else {
            return None;
        };
        Some(Value::Storage {
            element: Element::from_class(name)?,
            key: key.clone(),
        })
    }

    fn tuple(&self, id: Id) -> Option<&[Id]> {
        match self.values.get(id)? {
            Value::Tuple(items) => Some(items),
            _ => None,
        }
    }

    fn size(&self, id: Id) -> Option<usize> {
        match self.values.get(id)? {
            Value::Int(size) => usize::try_from(*size).ok(),
            _ => None,
        }
    }
}

/// What a call gives: a new value, or one that is there already.
enum Made {
    New(Value),
    Known(Id),
}

fn pairs(items: &[Id]) -> Vec<(Id, Id)> {
    items
        .chunks_exact(2)
        .map(|pair| (pair[0], pair[1]))
        .collect()
}
