//! Animations (glTF 2.0 §3.11, Appendix C): where nodes are at a time, and the paths of cameras that they move.
//!
//! Nothing is played: the scene is shown as it stands at one time, and a camera that moves is a path to walk.

use std::collections::HashMap;

use super::accessor::Accessors;
use super::buffers::Buffers;
use super::document::{Animation, Channel, Document};
use super::number::Index;
use super::pointers::{self, Place, Value};
use super::{Oddities, Problem, get};
use foveal::math;

/// Keys of all animations that are read.
const KEYS_MAX: usize = 1 << 26;

/// Moments of a path.
const MOMENTS_MAX: usize = 1 << 14;

/// Moments per second of what does not move straight from key to key.
const RATE: f32 = 60.0;

/// What a channel moves of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Property {
    Translation,
    Rotation,
    Scale,
    /// Of the morph targets of its mesh.
    Weights,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Interpolation {
    Linear,
    Step,
    Cubic,
}

/// Values over time.
#[derive(Debug)]
struct Track {
    /// Whether values are unit quaternions.
    turns: bool,
    interpolation: Interpolation,
    /// Rising strictly, seconds.
    times: Vec<f32>,
    /// Numbers of one value.
    width: usize,
    /// One value for each time; three where the interpolation is cubic: in-tangent, value, out-tangent.
    values: Vec<f32>,
}

/// What animations make of nodes, and of other values.
#[derive(Debug, Default)]
pub(super) struct Motion {
    tracks: HashMap<u32, Vec<(Property, Track)>>,
    pointed: Vec<(Value, Track)>,
}

/// Translation, rotation and scale of a node at a moment, where a channel sets them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Moved {
    pub translation: Option<[f32; 3]>,
    pub rotation: Option<[f32; 4]>,
    pub scale: Option<[f32; 3]>,
}

/// The animation to show: the one of that name, else the first.
pub(super) fn chosen<'d>(
    document: &'d Document,
    play: Option<&str>,
    odd: &mut Oddities,
) -> Option<(usize, &'d Animation)> {
    let first = document.animations.iter().enumerate().next();
    let Some(wanted) = play else { return first };
    let found = document.animations.iter().enumerate().find(|(_, a)| a.name.as_deref() == Some(wanted));
    if found.is_none() {
        let what = format!("animation \"{}\" that the sidecar plays", super::buffers::shortened(wanted));
        odd.count(&what, "not in the file; its first is taken");
    }
    found.or(first)
}

/// Reads the channels of an animation. What of them cannot be used is left out, with a line.
pub(super) fn read<'d>(
    (number, animation): (usize, &'d Animation),
    document: &'d Document,
    buffers: &mut Buffers<'d>,
    odd: &mut Oddities,
) -> Result<Motion, Problem> {
    let mut motion = Motion::default();
    let mut accessors = Accessors::new(document, buffers);
    let mut keys = 0;
    for channel in animation.channels.iter() {
        let Some(moves) = moved_by(channel, odd) else { continue };
        if let Place::Node(node, _) = moves {
            get(&document.nodes, Index(node), "nodes")?;
        }
        let place = format!("animations/{number}/samplers");
        let sampler = get(&animation.samplers, channel.sampler, &place)?;
        let interpolation = match sampler.interpolation.as_deref() {
            None | Some("LINEAR") => Interpolation::Linear,
            Some("STEP") => Interpolation::Step,
            Some("CUBICSPLINE") => Interpolation::Cubic,
            Some(_) => {
                odd.count("an unknown interpolation", "played straight from key to key");
                Interpolation::Linear
            }
        };
        let each = if interpolation == Interpolation::Cubic { 3 } else { 1 };
        let count = accessors.count(sampler.input)?;
        let found = accessors.count(sampler.output)?;
        let per_key = found.checked_div(count).unwrap_or(0);
        // Of morph targets there are as many numbers as targets.
        let (width, fits) = match moves {
            Place::Node(_, Property::Rotation) => (4, per_key == each),
            Place::Node(_, Property::Translation | Property::Scale) => (3, per_key == each),
            Place::Node(_, Property::Weights) => (per_key / each, per_key.is_multiple_of(each)),
            Place::Value(value) => (value.width() as u64, per_key == each),
        };
        if count == 0 || width == 0 || !fits || found != per_key * count {
            odd.count("an animation with more or fewer values than times", "left out");
            continue;
        }
        keys += found.max(count) as usize;
        if keys > KEYS_MAX {
            let message = format!("has more than {KEYS_MAX} keys; export with fewer");
            return Err(Problem::new(format!("/animations/{number}"), message));
        }
        let times =
            accessors.floats::<1>(sampler.input, "times")?.into_iter().map(|[t]| t).collect::<Vec<_>>();
        let rises = times.windows(2).all(|t| t[0] < t[1]) && times.iter().all(|t| t.is_finite());
        let turns = matches!(moves, Place::Node(_, Property::Rotation));
        let is_scalar = matches!(moves, Place::Node(_, Property::Weights));
        let values = values(&mut accessors, sampler.output, if is_scalar { 1 } else { width })?;
        if !rises || !values.iter().all(|v| v.is_finite()) {
            odd.count("an animation whose times do not rise, or whose values are no numbers", "left out");
            continue;
        }
        let track = Track { turns, interpolation, times, width: width as usize, values };
        match moves {
            Place::Node(node, property) => motion.tracks.entry(node).or_default().push((property, track)),
            Place::Value(value) => motion.pointed.push((value, track)),
        }
    }
    Ok(motion)
}

/// What a channel moves; `None` with a line where that is not shown.
fn moved_by(channel: &Channel, odd: &mut Oddities) -> Option<Place> {
    if let Some(pointer) = &channel.target.extensions.pointer {
        let named = pointers::named(&pointer.pointer);
        if named.is_none() {
            let what = format!("an animation of {}", super::buffers::shortened(&pointer.pointer));
            odd.count(&what, "not played");
        }
        return named;
    }
    let property = match channel.target.path.as_str() {
        "translation" => Property::Translation,
        "rotation" => Property::Rotation,
        "scale" => Property::Scale,
        "weights" => Property::Weights,
        _ => {
            odd.count("an animation of something unknown", "not played");
            return None;
        }
    };
    Some(Place::Node(channel.target.node?.0, property))
}

/// Vectors of `width` numbers, one after the other.
fn values(accessors: &mut Accessors<'_, '_>, output: Index, width: u64) -> Result<Vec<f32>, Problem> {
    const OF: &str = "values of this channel";
    Ok(match width {
        1 => accessors.floats::<1>(output, OF)?.into_flattened(),
        3 => accessors.floats::<3>(output, OF)?.into_flattened(),
        _ => accessors.floats::<4>(output, OF)?.into_flattened(),
    })
}

impl Motion {
    /// Whether a node moves by itself.
    pub fn moves(&self, node: usize) -> bool {
        self.tracks.contains_key(&(node as u32))
    }

    /// What a node's transform is at a time, seconds.
    pub fn at(&self, node: usize, time: f32) -> Moved {
        let mut moved = Moved::default();
        for (property, track) in self.tracks.get(&(node as u32)).into_iter().flatten() {
            match (property, track.at(time).as_slice()) {
                (Property::Translation, &[x, y, z]) => moved.translation = Some([x, y, z]),
                (Property::Rotation, &[x, y, z, w]) => moved.rotation = Some([x, y, z, w]),
                (Property::Scale, &[x, y, z]) => moved.scale = Some([x, y, z]),
                _ => {}
            }
        }
        moved
    }

    /// The weights of a node's morph targets at a time, where a channel sets them.
    pub fn weights(&self, node: usize, time: f32) -> Option<Vec<f32>> {
        let tracks = self.tracks.get(&(node as u32))?;
        tracks.iter().rfind(|(property, _)| *property == Property::Weights).map(|(_, track)| track.at(time))
    }

    /// What else is to be changed, and to what, at a time.
    pub fn values(&self, time: f32) -> impl Iterator<Item = (Value, Vec<f32>)> + '_ {
        self.pointed.iter().map(move |(value, track)| (*value, track.at(time)))
    }

    /// The moments at which what hangs from these nodes is to be looked at, rising.
    pub fn moments(&self, nodes: &[usize], odd: &mut Oddities) -> Vec<f32> {
        let mut moments: Vec<f32> = Vec::new();
        for (_, track) in nodes.iter().flat_map(|&n| self.tracks.get(&(n as u32)).into_iter().flatten()) {
            moments.extend(&track.times);
            let (Some(&first), Some(&last)) = (track.times.first(), track.times.last()) else { continue };
            if track.interpolation != Interpolation::Linear {
                let steps = (((last - first) * RATE) as usize).min(MOMENTS_MAX);
                moments.extend((0..steps).map(|i| first + i as f32 / RATE));
            }
        }
        moments.sort_unstable_by(f32::total_cmp);
        // Closer than this nobody sees a difference, and a path needs times that rise.
        moments.dedup_by(|b, a| *b - *a < 1e-4);
        if moments.len() > MOMENTS_MAX {
            odd.count("a camera with more keys than a path holds", "every so many are kept");
            let step = moments.len().div_ceil(MOMENTS_MAX);
            moments = moments.into_iter().step_by(step).collect();
        }
        moments
    }
}

impl Track {
    fn at(&self, time: f32) -> Vec<f32> {
        let each = if self.interpolation == Interpolation::Cubic { 3 } else { 1 };
        let part = |i: usize| &self.values[i * self.width..(i + 1) * self.width];
        let value = |i: usize| part(i * each + each / 2);
        let passed = self.times.partition_point(|&t| t <= time);
        let last = self.times.len() - 1;
        if passed == 0 || passed > last {
            return self.unit(value(passed.min(last)).to_vec());
        }
        let (a, b) = (passed - 1, passed);
        let step = self.times[b] - self.times[a];
        let s = (time - self.times[a]) / step;
        let (from, to) = (value(a), value(b));
        let each_of = |f: &dyn Fn(usize) -> f32| (0..self.width).map(f).collect();
        self.unit(match self.interpolation {
            Interpolation::Step => from.to_vec(),
            Interpolation::Linear => match (from, to) {
                (&[x, y, z, w], &[i, j, k, l]) if self.turns => slerp([x, y, z, w], [i, j, k, l], s).to_vec(),
                _ => each_of(&|c| from[c] + (to[c] - from[c]) * s),
            },
            Interpolation::Cubic => {
                let (out, into) = (part(3 * a + 2), part(3 * b));
                let (s2, s3) = (s * s, s * s * s);
                each_of(&|c| {
                    from[c] * (2.0 * s3 - 3.0 * s2 + 1.0)
                        + out[c] * (step * (s3 - 2.0 * s2 + s))
                        + to[c] * (3.0 * s2 - 2.0 * s3)
                        + into[c] * (step * (s3 - s2))
                })
            }
        })
    }

    fn unit(&self, v: Vec<f32>) -> Vec<f32> {
        let length = v.iter().map(|c| c * c).sum::<f32>().sqrt();
        if self.turns && length > 0.0 { v.into_iter().map(|c| c / length).collect() } else { v }
    }
}

/// The short way from one rotation to another.
fn slerp(a: [f32; 4], b: [f32; 4], s: f32) -> [f32; 4] {
    let cosine: f32 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    let sign = if cosine < 0.0 { -1.0 } else { 1.0 };
    let cosine = (cosine * sign).min(1.0);
    // Where they are close the arc is straight.
    let (wa, wb) = if cosine > 0.9995 {
        (1.0 - s, s)
    } else {
        let angle = math::acos(cosine);
        let sine = math::sin(angle);
        (math::sin((1.0 - s) * angle) / sine, math::sin(s * angle) / sine)
    };
    std::array::from_fn(|c| a[c] * wa + b[c] * (wb * sign))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(property: Property, interpolation: Interpolation, values: &[[f32; 4]]) -> Track {
        let turns = property == Property::Rotation;
        let values = values.as_flattened().to_vec();
        Track { turns, interpolation, times: vec![1.0, 3.0], width: 4, values }
    }

    #[test]
    fn values_are_those_of_the_text() {
        let (a, b) = ([1.0, 2.0, 3.0, 0.0], [3.0, 2.0, -1.0, 0.0]);
        let straight = track(Property::Translation, Interpolation::Linear, &[a, b]);
        assert_eq!([0.0, 2.0, 9.0].map(|t| straight.at(t)), [a, [2.0, 2.0, 1.0, 0.0], b].map(|v| v.to_vec()));
        let step = track(Property::Translation, Interpolation::Step, &[a, b]);
        assert_eq!([2.99, 3.0].map(|t| step.at(t)), [a, b].map(|v| v.to_vec()));
        // With the tangents of a straight line a cubic is one; half way tangents count an eighth of the time between.
        let slope = [1.0, 0.0, -2.0, 0.0];
        let cubic = track(Property::Translation, Interpolation::Cubic, &[slope, a, slope, slope, b, slope]);
        assert_eq!(
            [1.0, 2.0, 2.5].map(|t| cubic.at(t)),
            [a.to_vec(), vec![2.0, 2.0, 1.0, 0.0], straight.at(2.5)]
        );
        let flat = track(Property::Scale, Interpolation::Cubic, &[[0.0; 4], a, slope, [0.0; 4], b, slope]);
        assert_eq!(flat.at(2.0)[0], 2.0 + 2.0 / 8.0);
    }

    #[test]
    fn rotations_go_the_short_way_and_stay_unit() {
        let h = 0.5f32.sqrt();
        let turn = |sign: f32| {
            track(
                Property::Rotation,
                Interpolation::Linear,
                &[[0.0, 0.0, 0.0, 1.0], [0.0, h * sign, 0.0, h * sign]],
            )
        };
        let (s, c) = math::sin_cos(std::f32::consts::FRAC_PI_8);
        for sign in [1.0, -1.0] {
            let q = turn(sign).at(2.0);
            assert!((q[1] - s).abs() < 1e-6 && (q[3] - c).abs() < 1e-6, "{q:?}");
        }
        let near = slerp([0.0, 0.0, 0.0, 1.0], [0.0, 0.001, 0.0, 1.0], 0.5);
        assert!((near[1] - 0.0005).abs() < 1e-7);
        let long = track(Property::Rotation, Interpolation::Step, &[[0.0, 3.0, 0.0, 4.0]; 2]);
        assert_eq!(long.at(0.0), [0.0, 0.6, 0.0, 0.8]);
    }
}
