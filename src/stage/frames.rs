//! Frames of a window in time.

/// Something of each frame of a window in time (thesis 8.6): of the frame that is filtered, and of the frames beside
/// it, whose pixels take part as neighbours.
#[derive(Clone, Debug)]
pub struct Frames<T> {
    /// Of the frame that is filtered.
    pub own: T,
    /// Of the frames beside it.
    pub beside: Vec<T>,
}

impl<T> Frames<T> {
    /// One frame alone.
    pub fn one(own: T) -> Self {
        Self { own, beside: Vec::new() }
    }

    /// All frames, the own one first.
    pub fn iter(&self) -> impl Iterator<Item = &T> {
        std::iter::once(&self.own).chain(&self.beside)
    }

    /// What `of` makes of each frame, the own one first.
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

    /// Pairs what two windows have of each frame; both have as many frames.
    pub fn zip<U>(self, other: Frames<U>) -> Frames<(T, U)> {
        Frames { own: (self.own, other.own), beside: self.beside.into_iter().zip(other.beside).collect() }
    }

    /// The frames by reference.
    pub fn as_ref(&self) -> Frames<&T> {
        Frames { own: &self.own, beside: self.beside.iter().collect() }
    }
}

impl<T, U> Frames<(T, U)> {
    /// Parts the pairs.
    pub fn unzip(self) -> (Frames<T>, Frames<U>) {
        let (first, second) = self.beside.into_iter().unzip();
        (Frames { own: self.own.0, beside: first }, Frames { own: self.own.1, beside: second })
    }
}
