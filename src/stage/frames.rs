//! Frames of a window in time.

/// Data of each frame of a window in time (thesis 8.6): of the frame that is filtered, and of the frames beside it,
/// whose pixels take part as neighbours.
#[derive(Clone, Debug)]
pub struct Frames<T> {
    /// Data of the frame that is filtered.
    pub own: T,
    /// Data of the frames beside it.
    pub beside: Vec<T>,
}

impl<T> Frames<T> {
    /// Makes a window of one frame.
    pub fn one(own: T) -> Self {
        Self { own, beside: Vec::new() }
    }

    /// Returns the data of all frames, the own frame first.
    pub fn iter(&self) -> impl Iterator<Item = &T> {
        std::iter::once(&self.own).chain(&self.beside)
    }

    /// Applies `of` to the data of each frame, the own frame first.
    pub fn map<U>(self, mut of: impl FnMut(T) -> U) -> Frames<U> {
        Frames { own: of(self.own), beside: self.beside.into_iter().map(of).collect() }
    }

    /// As [`Frames::map`], until `of` fails.
    ///
    /// # Errors
    /// The first error of `of`.
    pub fn try_map<U, E>(self, mut of: impl FnMut(T) -> Result<U, E>) -> Result<Frames<U>, E> {
        Ok(Frames { own: of(self.own)?, beside: self.beside.into_iter().map(of).collect::<Result<_, E>>()? })
    }

    /// Pairs the data of two windows, which have equal numbers of frames.
    pub fn zip<U>(self, other: Frames<U>) -> Frames<(T, U)> {
        Frames { own: (self.own, other.own), beside: self.beside.into_iter().zip(other.beside).collect() }
    }

    /// Returns references to the data of all frames.
    pub fn as_ref(&self) -> Frames<&T> {
        Frames { own: &self.own, beside: self.beside.iter().collect() }
    }
}

impl<T, U> Frames<(T, U)> {
    /// Splits a window of pairs into two windows.
    pub fn unzip(self) -> (Frames<T>, Frames<U>) {
        let (first, second) = self.beside.into_iter().unzip();
        (Frames { own: self.own.0, beside: first }, Frames { own: self.own.1, beside: second })
    }
}
