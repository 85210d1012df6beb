//! What an adapter does to a tensor of its base.

use super::initial::Initial;
use crate::MllmError;
use crate::checkpoint::BaseTensor;

/// A change by the names of the adapter.
#[derive(Debug)]
pub(super) struct Entry {
    /// The tensor of the base, as Hugging Face's files of it call it; of a GGUF file its canonical
    /// name.
    pub(super) target: Target,
    /// The tensor of the adapter that messages name.
    pub(super) tensor: String,
    pub(super) change: Change,
}

/// A tensor of the base.
#[derive(Debug)]
pub(super) enum Target {
    Stored(String),
    Canonical(String),
}

/// A change of one tensor. Changes of a tensor are made in the order of these kinds.
#[derive(Debug, Clone)]
pub(super) enum Change {
    /// The adapter's own numbers in place of the base's.
    Replace {
        tensor: BaseTensor,
        rows: Rows,
        /// Whether the adapter's training had a copy of its own of an embedding that its base ties
        /// to the output layer.
        own: bool,
    },
    LowRank(LowRank),
    /// A vector that is added, multiplied by a number.
    Add {
        tensor: BaseTensor,
        scale: f32,
        rows: Rows,
    },
    /// New rows of an embedding.
    Tokens {
        tensor: BaseTensor,
        indices: Vec<usize>,
    },
    Experts(Experts),
}

/// Rows of the adapter's tensor, and where they lie in the base's, which may hold the rows of
/// several layers, or of a part of one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rows {
    All,
    Part {
        source: usize,
        target: usize,
        count: usize,
    },
}

/// A product of two small matrices that is added to a matrix.
#[derive(Debug, Clone)]
pub(super) struct LowRank {
    /// (rows of the target, rank).
    pub(super) left: Factor,
    /// (rank, columns of the target).
    pub(super) right: Factor,
    pub(super) rank: usize,
    pub(super) scale: f32,
    /// What the base loses before.
    pub(super) initial: Initial,
    /// `DoRA`'s length of each output's weights after it.
    pub(super) magnitude: Option<BaseTensor>,
    /// Whether the outputs are the columns of the target: of an embedding, and of GPT-2's layers.
    pub(super) transposed: bool,
    /// Whether the target may be one whose outputs are its columns, where its shape says so.
    pub(super) flips: bool,
    pub(super) rows: Rows,
}

/// One of the two matrices, behind the first axis all others as one.
#[derive(Debug, Clone)]
pub(super) struct Factor {
    pub(super) tensor: BaseTensor,
    /// Whether the file has its columns as rows.
    pub(super) transposed: bool,
}

/// The low-rank changes of all experts of a layer, whose weights are one tensor of three axes.
#[derive(Debug, Clone)]
pub(super) struct Experts {
    /// (experts times rank, one axis): the ranks of an expert follow one another.
    pub(super) a: BaseTensor,
    /// (other axis, rank times experts): the experts of a rank follow one another.
    pub(super) b: BaseTensor,
    pub(super) rank: usize,
    pub(super) scale: f32,
    /// Whether A belongs to the second axis, as in PEFT before 0.19.
    pub(super) older: bool,
}

impl Factor {
    /// Rows and columns.
    pub(super) fn shape(&self) -> Option<[usize; 2]> {
        let [rows, columns] = flat(self.tensor.shape())?;
        Some(if self.transposed {
            [columns, rows]
        } else {
            [rows, columns]
        })
    }

    pub(super) fn values(&self) -> Result<Vec<f32>, MllmError> {
        let values = self.tensor.values()?;
        match flat(self.tensor.shape()) {
            Some([rows, columns]) if self.transposed => Ok(transposed(&values, rows, columns)),
            _ => Ok(values),
        }
    }
}

/// A shape as a matrix of the first axis and all others. None for a vector, and for a tensor without
/// numbers.
pub(super) fn flat(shape: &[usize]) -> Option<[usize; 2]> {
    let (rows, rest) = shape.split_first()?;
    let columns = rest
        .iter()
        .try_fold(1_usize, |columns, side| columns.checked_mul(*side))?;
    (!rest.is_empty() && *rows > 0 && columns > 0).then_some([*rows, columns])
}

/// The columns of a matrix as rows.
pub(super) fn transposed(values: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    let mut result = vec![0.0; values.len()];
    for (row, numbers) in values.chunks_exact(columns.max(1)).enumerate() {
        let places = result.iter_mut().skip(row).step_by(rows.max(1));
        for (place, number) in places.zip(numbers) {
            *place = *number;
        }
    }
    result
}

impl Change {
    /// The order in which the changes of a tensor are made.
    pub(super) fn order(&self) -> u8 {
        match self {
            Self::Replace { .. } => 0,
            Self::LowRank(_) | Self::Experts(_) => 1,
            Self::Add { .. } => 2,
            Self::Tokens { .. } => 3,
        }
    }

    /// The same product for a matrix whose columns are the outputs.
    pub(super) fn flipped(self) -> Self {
        let Self::LowRank(low) = self else {
            return self;
        };
        let turned = |factor: Factor| Factor {
            transposed: !factor.transposed,
            ..factor
        };
        Self::LowRank(LowRank {
            left: turned(low.right),
            right: turned(low.left),
            transposed: !low.transposed,
            ..low
        })
    }

    /// The same change of some rows; none if it is not one of rows.
    pub(super) fn of_rows(mut self, part: Rows) -> Option<Self> {
        match &mut self {
            Self::Replace { rows, .. } | Self::Add { rows, .. } => *rows = part,
            Self::LowRank(low) if low.initial == Initial::Same && !low.transposed => {
                low.rows = part;
            }
            Self::LowRank(_) | Self::Tokens { .. } | Self::Experts(_) => return None,
        }
        Some(self)
    }

    /// The adapter's tensor that a message about shapes names.
    pub(super) fn main_tensor(&self) -> &BaseTensor {
        match self {
            Self::Replace { tensor, .. }
            | Self::Add { tensor, .. }
            | Self::Tokens { tensor, .. } => tensor,
            Self::LowRank(low) => &low.left.tensor,
            Self::Experts(experts) => &experts.a,
        }
    }
}
