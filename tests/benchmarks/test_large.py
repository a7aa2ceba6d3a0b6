"""A large skill: 7 channels at 200 Hz, 3000 windows."""

from benchmarks.fresh_process import learn


def test_large_fit(benchmark, figures):
    found = benchmark.pedantic(learn, args=(1200, 7, 3000, 10), rounds=1)
    assert found["windows"] == 3000
    figures.section = "Large: T = 1200, D = 7, N = 3000 windows, M = 10, fresh process"
    figures.add("fit", found["fit_s"], "s", below=60)
    figures.add("peak memory of the process", found["peak_mb"], "MB", below=2000)
    figures.add("mapping, K = 10", found["map_us"], "us", below=1000)
    figures.add("principal directions", found["rank"])
