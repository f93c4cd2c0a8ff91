import sys; sys.path.insert(0,"/tmp/e60")
from exp5 import *
from exp1 import _curvature,_trust
from exp4 import strength as st4
for l in open(sys.argv[1]):
    r=json.loads(l); s=random_scan(r["seed"],r["n"],CACHE); A,p=s.A,s.p
    e=np.array([q["e"] for q in r["rows"]]); err=np.array([q["err"] for q in r["rows"]]); best=err.min()
    x,c,m2=newfast(A,p,s.photons,passes=1)
    # lambda of best: beta V/mean
    w=1/(noise_var(p,s.photons)+np.float32(r["m2"]))
    V=float(np.prod(A.grid.voxel)); mean=float(A.T(A(np.ones(A.domain_shape,np.float32))*w).mean())
    lb=10*2.0**e[err.argmin()]/s.mu*V/mean
    b4,_=st4(A,s,r["m2"]); l4=b4*V/mean
    x4=None
    print(r["seed"],s.family,"m2/m2exp3 %.2f"%(m2/r["m2"]),"log2 lambda/best: new %.2f exp4 %.2f"%(np.log2(c.strength/lb),np.log2(l4/lb)),flush=True)
