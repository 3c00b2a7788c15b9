exec(open('/tmp/mix.py').read().split("def prep")[0])
print(len(p.windows), sum(w.n_pixels for w in p.windows)/p.n_pixels, p.windows[:3])
from ddic.images.spline import read_gradient
print(p.source.image.values.flags)
print(K.alternated({'g':lambda:[read_gradient(p.source.image,w,3) for w in p.windows]}), p.n_pixels)
