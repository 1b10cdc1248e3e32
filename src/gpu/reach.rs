//! How far the content of a buffer depends on the frame around a pixel, as a dry run finds it.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::UVec2;

use super::bindings::{Slot, SlotKind, Value};

/// Parts of a buffer, each with a reach of its own. The stages decide what the parts hold: in a signal, the front is
/// the mean and the back is the half spread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Parts {
    /// Both parts as one.
    Whole,
    /// Both parts, each by itself.
    Apart,
    Front,
    Back,
}

/// Columns and rows beside a pixel on which the two parts of a buffer depend.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Reach {
    pub(super) front: UVec2,
    pub(super) back: UVec2,
}

impl Reach {
    /// Returns the reach of data that is computed from these parts, for its front and for its back.
    fn of(self, parts: Parts) -> Self {
        let both = |reach| Self { front: reach, back: reach };
        match parts {
            Parts::Whole => both(self.front.max(self.back)),
            Parts::Apart => self,
            Parts::Front => both(self.front),
            Parts::Back => both(self.back),
        }
    }
}

/// The reach of a buffer, which grows with every stage that writes to it.
#[derive(Default)]
pub(super) struct SharedReach {
    front: AtomicU64,
    back: AtomicU64,
}

impl SharedReach {
    pub(super) fn get(&self) -> Reach {
        let unpack = |reach: &AtomicU64| {
            let packed = reach.load(Ordering::Relaxed);
            UVec2::new((packed >> 32) as u32, packed as u32)
        };
        Reach { front: unpack(&self.front), back: unpack(&self.back) }
    }

    fn grow(&self, parts: Parts, to: Reach) {
        let old = self.get();
        let to = if parts == Parts::Whole { to.of(Parts::Whole) } else { to };
        let store = |reach: &AtomicU64, value: UVec2| {
            reach.store(u64::from(value.x) << 32 | u64::from(value.y), Ordering::Relaxed);
        };
        if parts != Parts::Back {
            store(&self.front, old.front.max(to.front));
        }
        if parts != Parts::Front {
            store(&self.back, old.back.max(to.back));
        }
    }
}

/// Updates the reach of all buffers that a stage writes: the largest reach of its inputs, each extended by the distance
/// within which the stage reads that input.
pub(super) fn propagate(slots: &[Slot], values: &[Value<'_>]) {
    let buffers = || {
        slots.iter().zip(values).filter_map(|(slot, value)| match value {
            Value::Buffer(around) => Some((slot.kind, around)),
            Value::Uniform(_) | Value::Absent => None,
        })
    };
    let read = buffers().fold(Reach::default(), |most, (_, around)| {
        let Reach { front, back } = around.buffer.shared_reach().get().of(around.parts);
        Reach { front: most.front.max(front + around.radii.front), back: most.back.max(back + around.radii.back) }
    });
    for (_, around) in buffers().filter(|(kind, _)| *kind == SlotKind::Write) {
        around.buffer.shared_reach().grow(around.parts, read);
    }
}
