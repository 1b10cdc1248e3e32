use stein::buffers::*;
use stein::gpu::*;
use stein::*;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let gpu = Gpu::open(&DeviceChoice::Auto).unwrap();
    gpu.set_timing(true);
    let p = if a.get(3).map(|s| s == "thesis").unwrap_or(false) { Params::thesis() } else { Params::default() };
    let d = Denoiser::new(&gpu, p).unwrap();
    let set = BufferSet::read(&BufferSetRequest { input: a[1].clone().into(), ..Default::default() }).unwrap();
    let (f, _) = Frame::from_buffer_set(&set).unwrap();
    let r = read_reference(a[2].as_ref(), None).unwrap();
    for _ in 0..2 {
        let t = std::time::Instant::now();
        let keep = stein::method::dfc::Intermediate::ALL;
        let e = d.denoise_with(&f, Options { keep: &keep, progress: None }).unwrap();
        println!("time {:?} peak {} MiB", t.elapsed(), e.peak_bytes >> 20);
        println!("noisy {:.6} final {:.6}", metric::relative_mse(&f.color().mean, &r).unwrap(), metric::relative_mse(&e.color, &r).unwrap());
        for l in &e.layers {
            if l.image.channels() == 3 && (l.name == "pass1" || l.name == "first" || l.name == "second" || l.name == "third") {
                println!("{} {:.6}", l.name, metric::relative_mse(&l.image, &r).unwrap());
            }
            if l.name.starts_with("sure") || l.name.starts_with("sel") {
                println!("{} {:?}", l.name, l.image.planes.iter().map(|p| p.iter().map(|&x| x as f64).sum::<f64>() / p.len() as f64).collect::<Vec<_>>());
            }
        }
        for s in e.stage_times.unwrap_or_default() {
            println!("  {:24} {:8.2} ms x{}", s.stage, s.seconds * 1e3, s.dispatches);
        }
    }
}
