//! Animations (glTF 2.0 §3.11, Appendix C): where nodes are at a time, and the paths of cameras that they move.
//!
//! Nothing is played: the scene is shown as it stands at one time, and a camera that moves is a path to walk.

use std::collections::HashMap;

use super::accessor::Accessors;
use super::buffers::Buffers;
use super::document::{Animation, Document};
use super::number::Index;
use super::{Oddities, Problem, get};
use crate::math;

/// Keys of all animations that are read.
const KEYS_MAX: usize = 1 << 26;

/// Moments of a path.
const MOMENTS_MAX: usize = 1 << 14;

/// Moments per second of what does not move straight from key to key.
const RATE: f32 = 60.0;

/// What a channel moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Property {
    Translation,
    Rotation,
    Scale,
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
    property: Property,
    interpolation: Interpolation,
    /// Rising strictly, seconds.
    times: Vec<f32>,
    /// One for each time; three where the interpolation is cubic: in-tangent, value, out-tangent.
    values: Vec<[f32; 4]>,
}

/// What animations make of nodes.
#[derive(Debug, Default)]
pub(super) struct Motion {
    tracks: HashMap<u32, Vec<Track>>,
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
        if channel.target.extensions.pointer.is_some() {
            odd.count("KHR_animation_pointer", "not played");
            continue;
        }
        let property = match channel.target.path.as_str() {
            "translation" => Property::Translation,
            "rotation" => Property::Rotation,
            "scale" => Property::Scale,
            "weights" => {
                odd.count("an animation of morph targets", "not played");
                continue;
            }
            _ => {
                odd.count("an animation of something unknown", "not played");
                continue;
            }
        };
        let Some(node) = channel.target.node else { continue };
        get(&document.nodes, node, "nodes")?;
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
        if accessors.count(sampler.output)? != each * count || count == 0 {
            odd.count("an animation with more or fewer values than times", "left out");
            continue;
        }
        keys += count as usize;
        if keys > KEYS_MAX {
            let message = format!("has more than {KEYS_MAX} keys; export with fewer");
            return Err(Problem::new(format!("/animations/{number}"), message));
        }
        let times =
            accessors.floats::<1>(sampler.input, "times")?.into_iter().map(|[t]| t).collect::<Vec<_>>();
        let rises = times.windows(2).all(|t| t[0] < t[1]) && times.iter().all(|t| t.is_finite());
        let values = values(&mut accessors, sampler.output, property)?;
        if !rises || !values.iter().flatten().all(|v| v.is_finite()) {
            odd.count("an animation whose times do not rise, or whose values are no numbers", "left out");
            continue;
        }
        let track = Track { property, interpolation, times, values };
        motion.tracks.entry(node.0).or_default().push(track);
    }
    Ok(motion)
}

fn values(
    accessors: &mut Accessors<'_, '_>,
    output: Index,
    property: Property,
) -> Result<Vec<[f32; 4]>, Problem> {
    if property == Property::Rotation {
        return accessors.floats::<4>(output, "rotations");
    }
    let read = accessors.floats::<3>(output, "values of this channel")?;
    Ok(read.into_iter().map(|[x, y, z]| [x, y, z, 0.0]).collect())
}

impl Motion {
    /// Whether a node moves by itself.
    pub fn moves(&self, node: usize) -> bool {
        self.tracks.contains_key(&(node as u32))
    }

    /// What a node's transform is at a time, seconds.
    pub fn at(&self, node: usize, time: f32) -> Moved {
        let mut moved = Moved::default();
        for track in self.tracks.get(&(node as u32)).into_iter().flatten() {
            let [x, y, z, w] = track.at(time);
            match track.property {
                Property::Translation => moved.translation = Some([x, y, z]),
                Property::Rotation => moved.rotation = Some([x, y, z, w]),
                Property::Scale => moved.scale = Some([x, y, z]),
            }
        }
        moved
    }

    /// The moments at which what hangs from these nodes is to be looked at, rising.
    pub fn moments(&self, nodes: &[usize], odd: &mut Oddities) -> Vec<f32> {
        let mut moments: Vec<f32> = Vec::new();
        for track in nodes.iter().flat_map(|&n| self.tracks.get(&(n as u32)).into_iter().flatten()) {
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
    fn at(&self, time: f32) -> [f32; 4] {
        let each = if self.interpolation == Interpolation::Cubic { 3 } else { 1 };
        let value = |i: usize| self.values[i * each + each / 2];
        let passed = self.times.partition_point(|&t| t <= time);
        let last = self.times.len() - 1;
        if passed == 0 || passed > last {
            return self.unit(value(passed.min(last)));
        }
        let (a, b) = (passed - 1, passed);
        let step = self.times[b] - self.times[a];
        let s = (time - self.times[a]) / step;
        self.unit(match self.interpolation {
            Interpolation::Step => value(a),
            Interpolation::Linear if self.property == Property::Rotation => slerp(value(a), value(b), s),
            Interpolation::Linear => std::array::from_fn(|c| value(a)[c] + (value(b)[c] - value(a)[c]) * s),
            Interpolation::Cubic => {
                let (out, into) = (self.values[3 * a + 2], self.values[3 * b]);
                let (s2, s3) = (s * s, s * s * s);
                std::array::from_fn(|c| {
                    value(a)[c] * (2.0 * s3 - 3.0 * s2 + 1.0)
                        + out[c] * (step * (s3 - 2.0 * s2 + s))
                        + value(b)[c] * (3.0 * s2 - 2.0 * s3)
                        + into[c] * (step * (s3 - s2))
                })
            }
        })
    }

    fn unit(&self, v: [f32; 4]) -> [f32; 4] {
        let length = v.iter().map(|c| c * c).sum::<f32>().sqrt();
        if self.property == Property::Rotation && length > 0.0 { v.map(|c| c / length) } else { v }
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
        Track { property, interpolation, times: vec![1.0, 3.0], values: values.to_vec() }
    }

    #[test]
    fn values_are_those_of_the_text() {
        let (a, b) = ([1.0, 2.0, 3.0, 0.0], [3.0, 2.0, -1.0, 0.0]);
        let straight = track(Property::Translation, Interpolation::Linear, &[a, b]);
        assert_eq!([0.0, 2.0, 9.0].map(|t| straight.at(t)), [a, [2.0, 2.0, 1.0, 0.0], b]);
        let step = track(Property::Translation, Interpolation::Step, &[a, b]);
        assert_eq!([2.99, 3.0].map(|t| step.at(t)), [a, b]);
        // With the tangents of a straight line a cubic is one; half way tangents count an eighth of the time between.
        let slope = [1.0, 0.0, -2.0, 0.0];
        let cubic = track(Property::Translation, Interpolation::Cubic, &[slope, a, slope, slope, b, slope]);
        assert_eq!([1.0, 2.0, 2.5].map(|t| cubic.at(t)), [a, [2.0, 2.0, 1.0, 0.0], straight.at(2.5)]);
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
