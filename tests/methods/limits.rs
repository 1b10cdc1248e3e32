//! Devices with small limits: work that exceeds a limit is cut up, with the same bits; work that cannot be cut is
//! refused with both numbers.

use stein::error::{DeviceCause, Remedy};
use stein::stage::nlm::Schedule;
use stein::{Denoiser, DfcParams, Error, GemParams, Method, NlmParams};

use crate::behaviour::{assert_same, denoised, random_frame};
use crate::common::{gpu, limited_gpu};

/// Bytes of a plane of the frame.
fn plane(width: usize, height: usize) -> u64 {
    16 * (width * height) as u64
}

fn binding(bytes: u64) -> stein::Gpu {
    limited_gpu(|limits| {
        limits.max_storage_buffer_binding_size = bytes;
        limits.max_buffer_size = bytes;
    })
}

fn small_windows() -> [Method; 2] {
    [1, 2].map(|window_radius| DfcParams { window_radius, ..DfcParams::default() }.into())
}

#[test]
fn running_sums_of_small_windows_fit_the_binding_limit() {
    let frame = random_frame(24, 300, 1.0);
    // The image fits whole. All of its column sums fit, too, and its running sums, three times as many, do not.
    let limited = binding(4 * plane(24, 300));
    for method in small_windows() {
        let expected = denoised(&Denoiser::new(gpu(), method).expect("it is in range"), &frame);
        for schedule in [Schedule::HARDWARE, Schedule::SOFTWARE] {
            let actual =
                denoised(&Denoiser::new(&limited, method).expect("it is in range").with_schedule(schedule), &frame);
            assert_eq!(actual.strips, 1);
            assert_same(&format!("{schedule:?}"), &actual, &expected, 1.0);
        }
    }
}

#[test]
fn a_row_whose_running_sums_do_not_fit_is_cut_into_bands() {
    let frame = random_frame(1000, 1, 1.0);
    let limited = binding(4 * plane(1000, 1));
    for method in small_windows() {
        let expected = denoised(&Denoiser::new(gpu(), method).expect("it is in range"), &frame);
        let actual = denoised(
            &Denoiser::new(&limited, method).expect("it is in range").with_schedule(Schedule::HARDWARE),
            &frame,
        );
        assert_same("bands", &actual, &expected, 1.0);
    }
}

fn methods() -> [Method; 3] {
    [
        DfcParams { window_radius: 1, ..DfcParams::default() }.into(),
        NlmParams { window_radius: 2, ..NlmParams::default() }.into(),
        GemParams::default().into(),
    ]
}

#[test]
fn the_largest_buffer_of_each_method_is_planned_for() {
    let frame = random_frame(24, 600, 1.0);
    // The signal of the colour fits whole, the results of the spike search do not.
    let limited = binding(5 * plane(24, 600) / 2);
    for method in methods() {
        let expected = denoised(&Denoiser::new(gpu(), method).expect("it is in range"), &frame);
        let actual = denoised(&Denoiser::new(&limited, method).expect("it is in range"), &frame);
        assert!(actual.strips > 1, "{}", method.name());
        assert_same(method.name(), &actual, &expected, 1.0);
    }
}

#[test]
fn an_image_that_no_strip_makes_fit_names_the_limit_that_it_exceeds() {
    // The halo of one row is the whole image, so the binding limit is the problem, not the memory.
    let limited = binding(5 * plane(24, 40) / 2);
    let denoiser = Denoiser::new(&limited, GemParams::default()).expect("it is in range");
    match denoiser.denoise(&random_frame(24, 40, 1.0)).map(drop) {
        Err(error @ Error::Device(DeviceCause::StripExceedsAdapter { .. })) => {
            let remedies = error.remedies();
            assert!(remedies.contains(&Remedy::AnotherAdapter), "{error}");
            assert!(!remedies.contains(&Remedy::RaiseMemoryLimit), "{error}");
        }
        other => panic!("{other:?}"),
    }
}

/// Workgroups per axis.
const GROUPS: u32 = 400;

#[test]
fn a_frame_higher_than_a_dispatch_is_cut_into_strips() {
    // Two rows per workgroup: more workgroups than the limit.
    let frame = random_frame(6, 2 * GROUPS as usize + 100, 1.0);
    let limited = limited_gpu(|limits| limits.max_compute_workgroups_per_dimension = GROUPS);
    for method in methods() {
        let expected = denoised(&Denoiser::new(gpu(), method).expect("it is in range"), &frame);
        let actual = denoised(&Denoiser::new(&limited, method).expect("it is in range"), &frame);
        assert_eq!(expected.strips, 1);
        assert!(actual.strips > 1, "{}", method.name());
        assert_same(method.name(), &actual, &expected, 1.0);
    }
}

#[test]
fn a_frame_as_wide_as_a_dispatch_is_denoised_and_a_wider_one_is_refused() {
    let limited = limited_gpu(|limits| limits.max_compute_workgroups_per_dimension = GROUPS);
    let most = 32 * GROUPS as usize;
    for method in methods() {
        let denoiser = |gpu| Denoiser::new(gpu, method).expect("it is in range");
        let frame = random_frame(most, 1, 1.0);
        assert_same(method.name(), &denoised(&denoiser(&limited), &frame), &denoised(&denoiser(gpu()), &frame), 1.0);
        match denoiser(&limited).denoise(&random_frame(most + 1, 1, 1.0)).map(drop) {
            Err(error @ Error::Device(DeviceCause::TooManyWorkgroups { groups: 401, axis: 'x', limit: 400, .. })) => {
                assert!(error.remedies().contains(&Remedy::CropImage), "{error}");
            }
            other => panic!("{other:?}"),
        }
    }
}
