import sys; sys.path.insert(0,"/tmp/e60")
from exp1 import *
from exp1 import _curvature,_trust
D=[json.loads(l) for l in open(sys.argv[1])]
for r in D:
    s=random_scan(r["seed"],r["n"],CACHE); A,p=s.A,s.p
    nv=noise_var(p,s.photons); w=1/(nv+np.float32(r["m2"]))
    n=len(A); k=10 if n<100 else 20
    ov=sorted(subsets_of(A.geometry,k)[0]); used=sorted(set(range(n))-set(ov))
    B,q,ww=A[used],p[used],w[used]
    x=sart(B,q,iterations=3,relaxation=1.0,nonnegative=True).array.copy()
    V=float(np.prod(A.grid.voxel)); 
    _,mean=_curvature([(B[v],v) for v in subsets_of(B.geometry,10)],_trust(B,ww,None)); rows=[]
    O=A[ov]; mw=float(np.mean(w[ov])*r["m2"])
    for e in [y["e"] for y in r["rows"]]:
        x=minimised(B,q,x,Variation(B,10*2.0**e/s.mu*V/mean,8,np.float32(0)),iterations=5,rounds=1,subsets=min(10,len(B)),weights=ww,huber=None,mask=None,callback=None).array.copy()
        rr=O(x)-p[ov]
        rows.append({"e":e,"err":s.error(x),"cv":float(np.mean(np.square(rr)*w[ov])),"R":float(np.mean(np.square(rr)))})
    r["part"]=rows; r["mw"]=mw; r["nvout"]=float(nv[ov].mean())
    print(json.dumps(r),flush=True)
