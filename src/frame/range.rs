//! The range of a feature, without values that lie far outside.

use crate::image::Image;

/// Width of a gap in distances or positions beyond which values count as outside, in multiples of the extent inside;
/// their unit may be anything.
const DISTANCE_GAP: f64 = 10.0;
/// Width of the gap in other features, which lie between 0 and 1 by nature: the extent inside counts as at least 1.
const OTHER_GAP: f64 = 4.0;
/// Largest share of the values of a feature other than a distance that may lie outside.
const OTHER_OUTSIDE: f64 = 0.01;
/// Largest number of values in a gap, as a share of the smaller group of values beside it: pixels at the edge of a sky
/// dome mix both distances. A tail without a gap is never cut: for a floor that runs to the horizon, nine values out of
/// ten lie between the last tenth and the tail itself.
const IN_GAP: f64 = 0.1;
/// The tail of the values inside continues as long as no step is wider than this share of their extent,
const TAIL_STEP: f64 = 0.1;
/// and up to this share beyond its end.
const TAIL: f64 = 0.5;
/// Largest extent of a sky without structure, as a share of the gap before it. Such a sky is cut off even if it fills
/// most of the image.
const FLAT: f64 = 0.01;
/// Least share of the values that must stay inside when a sky is cut off.
const LEAST_INSIDE: f64 = 0.1;

/// Range of the values of a feature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Range {
    /// Least value inside, over all channels.
    pub(super) least: f32,
    /// Greatest value inside.
    pub(super) greatest: f32,
    /// Number of values that lie outside, over all channels.
    pub(super) outside: usize,
    /// Least and greatest of all values; equal to the values inside if none lie outside.
    pub(super) all: (f32, f32),
}

/// Values that share their sign, exponent and first seven digits.
#[derive(Clone, Copy, Debug)]
struct Bin {
    count: usize,
    least: f32,
    greatest: f32,
}

impl Bin {
    /// Returns the bin of the negated values.
    fn mirrored(self) -> Self {
        Self { count: self.count, least: -self.greatest, greatest: -self.least }
    }
}

/// The values of a channel without those that lie far outside.
struct Inside<'a> {
    bins: &'a [Bin],
    /// Least of the values far above; ∞ if there are none.
    above: f32,
    /// Greatest of the values far below; −∞ if there are none.
    below: f32,
}

/// Returns the range of the hits of all channels; `(∞, −∞)` if there are no hits. Outliers and far clusters lie outside
/// if a wide and nearly empty gap separates them from the others.
///
/// `is_distance`: the feature is a distance or a position, of which a large part may be far away. The result depends on
/// the values, not on their order.
pub(super) fn range_of_hits(mean: &Image, misses: &[bool], is_distance: bool) -> Range {
    let channels: Vec<Vec<Bin>> = mean.planes.iter().map(|plane| bins(plane, misses)).collect();
    let span = |channels: &mut dyn Iterator<Item = &[Bin]>| {
        let ends = channels.filter_map(|bins| Some((bins.first()?.least, bins.last()?.greatest)));
        ends.fold((f32::INFINITY, f32::NEG_INFINITY), |(least, greatest), ends| {
            (least.min(ends.0), greatest.max(ends.1))
        })
    };
    let all = span(&mut channels.iter().map(Vec::as_slice));
    let inside: Vec<Inside> = channels.iter().map(|bins| Inside::new(bins, is_distance)).collect();
    let (mut least, mut greatest) = span(&mut inside.iter().map(|inside| inside.bins));

    // A value far outside in its own channel may be ordinary in another channel: all channels share one map.
    if greatest <= least {
        (least, greatest) = all;
    }
    let far = |is_far: fn(&Inside, &Bin) -> bool| {
        let bins =
            channels.iter().zip(&inside).flat_map(|(bins, inside)| bins.iter().filter(|bin| is_far(inside, bin)));
        let mut bins: Vec<Bin> = bins.copied().collect();
        bins.sort_unstable_by(|a, b| a.least.total_cmp(&b.least));
        bins
    };
    let gap = |least: f32, greatest: f32| gap_before_outside(f64::from(least), f64::from(greatest), is_distance);
    for bin in far(|inside, bin| bin.least >= inside.above) {
        if f64::from(bin.least) - f64::from(greatest) < gap(least, greatest) {
            greatest = greatest.max(bin.greatest);
        }
    }
    for bin in far(|inside, bin| bin.greatest <= inside.below).iter().rev() {
        if f64::from(least) - f64::from(bin.greatest) < gap(least, greatest) {
            least = least.min(bin.least);
        }
    }
    let outside =
        channels.iter().flatten().filter(|bin| bin.least > greatest || bin.greatest < least).map(|bin| bin.count).sum();
    Range { least, greatest, outside, all }
}

/// Returns the width of the gap beyond which values lie outside of a range.
fn gap_before_outside(least: f64, greatest: f64, is_distance: bool) -> f64 {
    if is_distance { DISTANCE_GAP * (greatest - least) } else { OTHER_GAP * (greatest - least).max(1.0) }
}

impl<'a> Inside<'a> {
    fn new(bins: &'a [Bin], is_distance: bool) -> Self {
        let all: usize = bins.iter().map(|bin| bin.count).sum();
        let mut inside = Self { bins, above: f32::INFINITY, below: f32::NEG_INFINITY };
        loop {
            if let Some((kept, outside)) = bins_below_gap(inside.bins, all, is_distance) {
                inside.bins = &inside.bins[..kept];
                inside.above = outside;
                continue;
            }
            let mirrored: Vec<Bin> = inside.bins.iter().rev().map(|bin| bin.mirrored()).collect();
            match bins_below_gap(&mirrored, all, is_distance) {
                Some((kept, outside)) => {
                    inside.bins = &inside.bins[inside.bins.len() - kept..];
                    inside.below = -outside;
                }
                None => return inside,
            }
        }
    }
}

/// Returns the number of bins below the lowest gap that separates values as outside, and the least of these values.
/// `None` if there is no such gap.
fn bins_below_gap(bins: &[Bin], all: usize, is_distance: bool) -> Option<(usize, f32)> {
    let total: usize = bins.iter().map(|bin| bin.count).sum();
    let share = |count: usize| count as f64 / all as f64;
    let least = f64::from(quantile(bins, total, 0.01)?.least);
    let greatest = f64::from(bins.last()?.greatest);
    let (mut below, mut next, mut below_next) = (0, 1, bins[0].count);
    for (index, bin) in bins.iter().enumerate() {
        below += bin.count;
        let end = f64::from(bin.greatest);
        if next <= index {
            (next, below_next) = (index + 1, below);
        }
        let start = end + gap_before_outside(least, end, is_distance);
        while next < bins.len() && f64::from(bins[next].least) < start {
            below_next += bins[next].count;
            next += 1;
        }
        let first_outside = bins.get(next)?;
        let outside = total - below_next;
        if (below_next - below) as f64 > IN_GAP * outside.min(below) as f64 {
            continue;
        }
        let is_cut = if is_distance {
            let gap = f64::from(first_outside.least) - end;
            let is_flat = greatest - f64::from(first_outside.least) <= FLAT * gap;
            (share(below) >= 0.5 || is_flat && share(below) >= LEAST_INSIDE)
                && is_filled(&bins[..=index], below, end - least)
        } else {
            share(all - below) <= OTHER_OUTSIDE
        };
        if is_cut {
            // The lowest gap that is empty enough may cut off a tail of the values inside, which is added again.
            let (step, end_of_tail) = (TAIL_STEP * (end - least), end + TAIL * (end - least));
            let is_tail = |pair: &&[Bin]| {
                let [low, high] = [f64::from(pair[0].greatest), f64::from(pair[1].least)];
                high - low <= step && f64::from(pair[1].greatest) <= end_of_tail
            };
            let tail = bins[index..next].windows(2).take_while(is_tail).count();
            return Some((index + 1 + tail, first_outside.least));
        }
    }
    None
}

/// Returns whether distances spread over their extent by more than a hair. The distances of a wall, or the 0 of most
/// pixels, are no scale for others.
fn is_filled(bins: &[Bin], count: usize, extent: f64) -> bool {
    let (Some(low), Some(high)) = (quantile(bins, count, 0.1), quantile(bins, count, 0.9)) else { return false };
    let largest =
        bins.iter().map(|bin| f64::from(bin.least).abs().max(f64::from(bin.greatest).abs())).fold(0.0, f64::max);
    extent > 0.0 && f64::from(high.greatest) - f64::from(low.least) >= 0.1 * extent && extent >= 0.1 * largest
}

/// Returns the bin that holds this share of `count` values.
fn quantile(bins: &[Bin], count: usize, share: f64) -> Option<Bin> {
    let rank = (share * count.saturating_sub(1) as f64) as usize;
    let mut below = 0;
    bins.iter().copied().find(|bin| {
        below += bin.count;
        below > rank
    })
}

/// Returns the bins of a channel's hits that are not empty, in rising order.
fn bins(plane: &[f32], misses: &[bool]) -> Vec<Bin> {
    let empty = Bin { count: 0, least: f32::INFINITY, greatest: f32::NEG_INFINITY };
    let mut bins = vec![empty; 1 << 16];
    for (value, _) in plane.iter().zip(misses).filter(|(_, miss)| !**miss) {
        // The bits of positive numbers rise with the numbers; the bits of negative numbers fall.
        let bits = (value + 0.0).to_bits();
        let ordered = if bits >> 31 == 0 { bits | 1 << 31 } else { !bits };
        let bin = &mut bins[(ordered >> 16) as usize];
        *bin = Bin { count: bin.count + 1, least: bin.least.min(*value), greatest: bin.greatest.max(*value) };
    }
    bins.retain(|bin| bin.count > 0);
    bins
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Extent;

    fn range(values: Vec<f32>, is_distance: bool) -> Range {
        let extent = Extent { width: values.len() as u32, height: 1 };
        let misses = vec![false; values.len()];
        range_of_hits(&Image { extent, planes: vec![values] }, &misses, is_distance)
    }

    fn ends(values: Vec<f32>, is_distance: bool) -> (f32, f32) {
        let found = range(values, is_distance);
        (found.least, found.greatest)
    }

    /// `count` values from `first` to `last` in equal steps.
    fn steps(count: usize, first: f32, last: f32) -> Vec<f32> {
        (0..count).map(|step| first + (last - first) * step as f32 / (count - 1) as f32).collect()
    }

    #[test]
    fn outliers_lie_outside_on_either_side() {
        let mut albedo = steps(1000, 0.125, 0.75);
        albedo[17] = 1000.0;
        albedo[400] = -300.0;
        albedo[401] = 30.0;
        let found = range(albedo, false);
        assert_eq!((found.least, found.greatest, found.outside, found.all), (0.125, 0.75, 3, (-300.0, 1000.0)));
    }

    #[test]
    fn a_sky_dome_lies_outside_whether_it_is_small_or_large_or_blurred_at_its_edge() {
        let dome = |share: usize| [steps(1000 - share, 1.0, 5.0), vec![1e4; share]].concat();
        for share in [1, 190, 800] {
            assert_eq!(ends(dome(share), true), (1.0, 5.0), "{share} of 1000");
        }
        assert_eq!(ends([dome(190), steps(15, 100.0, 9000.0)].concat(), true), (1.0, 5.0));
    }

    #[test]
    fn tails_and_pairs_of_levels_keep_their_range() {
        // A floor to the horizon, each row farther away than the one below.
        let floor: Vec<f32> = (1..=1000).map(|row| 1000.0 / row as f32).collect();
        assert_eq!(ends(floor, true), (1.0, 1000.0));
        // Seven decades, evenly.
        let decades: Vec<f32> = (0..1000).map(|step| 10f32.powf(step as f32 * 7.0 / 999.0)).collect();
        assert_eq!(ends(decades.clone(), true), (1.0, decades[999]));
        for (low, high, of_low) in [(0.0, 1.0, 999), (0.0, 1.0, 500), (5.0, 5000.0, 700)] {
            let values = [vec![low; of_low], vec![high; 1000 - of_low]].concat();
            assert_eq!((ends(values.clone(), true), ends(values, false)), ((low, high), (low, high)));
        }
        // A wall that is not quite even behind a chair.
        assert_eq!(ends([steps(900, 5.0, 5.001), steps(100, 3.0, 3.2)].concat(), true), (3.0, 5.001));
        // Most of it is black but for round-off.
        assert_eq!(ends([steps(950, 0.0, 1e-6), steps(50, 0.1, 1.0)].concat(), false), (0.0, 1.0));
        // A near thing before a wide landscape.
        assert_eq!(ends([steps(150, 1.0, 2.0), steps(850, 100.0, 1000.0)].concat(), true), (1.0, 1000.0));
    }

    #[test]
    fn what_is_far_in_one_channel_may_be_near_in_another() {
        let extent = Extent { width: 1000, height: 1 };
        let mut planes = vec![steps(1000, -5.0, 5.0), steps(1000, 0.0, 3.0), steps(1000, 1000.0, 1005.0)];
        let position =
            |planes: &Vec<Vec<f32>>| range_of_hits(&Image { extent, planes: planes.clone() }, &[false; 1000], true);
        assert_eq!((position(&planes).least, position(&planes).greatest), (-5.0, 1005.0));
        planes[1][3] = 900.0;
        assert_eq!(position(&planes).outside, 0);
    }

    #[test]
    fn a_milder_outlier_of_one_channel_does_not_hide_a_stronger_one_of_another() {
        let extent = Extent { width: 1000, height: 1 };
        let mut planes = vec![steps(1000, 0.1, 0.9); 3];
        (planes[0][3], planes[0][4], planes[1][4]) = (200.0, 8.0, 4.0);
        let found = range_of_hits(&Image { extent, planes }, &[false; 1000], false);
        // 4 is no outlier, so that 8 is none; 200 is one.
        assert_eq!((found.least, found.greatest, found.outside), (0.1, 8.0, 1));
    }

    #[test]
    fn nothing_is_left_of_no_hits() {
        let extent = Extent { width: 2, height: 1 };
        let found = range_of_hits(&Image::filled(extent, 1, 3.0), &[true; 2], true);
        assert_eq!((found.least, found.greatest, found.outside), (f32::INFINITY, f32::NEG_INFINITY, 0));
    }
}
