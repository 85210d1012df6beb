//! Whether a change fits the tensor that it is for.

use super::change::{Change, Experts, LowRank, Rows, flat};
use super::initial::Initial;

impl Change {
    /// Whether it changes the whole tensor at once.
    pub(super) fn is_whole(&self) -> bool {
        match self {
            Self::Replace { rows, .. } | Self::Add { rows, .. } => *rows == Rows::All,
            Self::LowRank(low) => low.rows == Rows::All,
            Self::Tokens { .. } | Self::Experts(_) => true,
        }
    }

    /// Rows of the adapter's tensor.
    pub(super) fn rows_of_source(&self) -> Option<usize> {
        match self {
            Self::LowRank(low) => low.left.shape().map(|[rows, _]| rows),
            other => other.main_tensor().shape().first().copied(),
        }
    }

    /// The change for a tensor of this shape; none if it does not fit.
    pub(super) fn fitting(self, shape: &[usize]) -> Option<Self> {
        let columns = flat(shape).map_or(1, |[_, columns]| columns);
        let height = shape.first().copied()?;
        let elements = |shape: &[usize]| shape.iter().product::<usize>();
        let fits = match &self {
            Self::Replace { tensor, rows, .. } | Self::Add { tensor, rows, .. } => match rows {
                Rows::All => tensor.shape() == shape,
                Rows::Part { .. } => {
                    rows.lie_within(height, tensor.shape())
                        && elements(tensor.shape()).is_multiple_of(columns)
                        && elements(tensor.shape()) / columns == tensor.shape().first().copied()?
                }
            },
            Self::Tokens { tensor, indices } => {
                shape.len() == 2
                    && tensor.shape() == [indices.len(), columns]
                    && indices.iter().all(|index| *index < height)
            }
            Self::LowRank(low) => {
                let matrix = flat(shape)?;
                let (left, right) = (low.left.shape()?, low.right.shape()?);
                let rows = match low.rows {
                    Rows::All => left == [matrix[0], low.rank],
                    part @ Rows::Part { .. } => {
                        left[1] == low.rank && part.lie_within(height, &left)
                    }
                };
                let fits = rows && right == [low.rank, matrix[1]] && low.rank > 0;
                if !fits && low.flips && low.rows == Rows::All && !low.transposed {
                    let flipped = Self::LowRank(LowRank {
                        flips: false,
                        ..low.clone()
                    });
                    // Of OLoRA only the orientation of linear layers is known.
                    return match low.initial {
                        Initial::FirstColumns { .. } => None,
                        _ => flipped.flipped().fitting(shape),
                    };
                }
                let outputs = if low.transposed { right[1] } else { left[0] };
                let magnitude = low.magnitude.as_ref();
                fits && magnitude.is_none_or(|magnitude| elements(magnitude.shape()) == outputs)
            }
            Self::Experts(experts) => experts.fit(shape),
        };
        fits.then_some(self).map(|change| change.of_axis(shape))
    }

    /// The same change with the axis of experts that the shape decides.
    fn of_axis(self, shape: &[usize]) -> Self {
        match (self, shape) {
            (Self::Experts(experts), &[_, rows, columns]) if rows != columns => {
                let older = experts.a.shape().get(1) == Some(&rows);
                Self::Experts(Experts { older, ..experts })
            }
            (change, _) => change,
        }
    }
}

impl Rows {
    /// Whether the rows lie within those of both tensors.
    fn lie_within(self, height: usize, source_shape: &[usize]) -> bool {
        match self {
            Self::All => true,
            Self::Part {
                source,
                target,
                count,
            } => {
                let end = |first: usize| first.checked_add(count);
                end(target).is_some_and(|end| end <= height)
                    && source_shape
                        .first()
                        .is_some_and(|rows| end(source).is_some_and(|end| end <= *rows))
            }
        }
    }
}

impl Experts {
    /// Whether A and B are those of all experts of a parameter, on either axis.
    fn fit(&self, shape: &[usize]) -> bool {
        let &[count, rows, columns] = shape else {
            return false;
        };
        let Some(all) = count.checked_mul(self.rank).filter(|all| *all > 0) else {
            return false;
        };
        let fits = |wide, high| self.a.shape() == [all, wide] && self.b.shape() == [high, all];
        rows > 0 && columns > 0 && (fits(columns, rows) || fits(rows, columns))
    }
}
