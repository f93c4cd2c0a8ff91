import sys, time, json, logging
sys.path.insert(0,"/work/one/benchmarks"); sys.path.insert(0,"/work/one/src")
import numpy as np
from pathlib import Path
from random_scans import random_scan
from twinct.recon import sart
from twinct.recon.fast import fast
from twinct.recon.fista import minimised, Variation, _curvature, _trust
from twinct.recon.order import subsets_of
from twinct.recon.resolution import binned
from twinct.recon.checks import remainder, counting_rays
import twinct
assert "/work/one" in twinct.__file__
CACHE=Path("/var/tmp/e60"); 
def rms(a): return float(np.sqrt(np.mean(np.square(a,dtype=np.float64))))
def noise_var(p, photons):
    if photons is None: return np.zeros_like(p)
    return (np.exp(np.clip(p,0,12))/photons).astype(np.float32)
def run(seed, size):
    s=random_scan(seed,size,CACHE)
    out={"seed":seed,"family":s.family,"path":s.path,"views":len(s.A),"photons":s.photons}
    A,p=s.A,s.p
    t=time.time()
    best={}
    for relax in (0.3,1.0):
        errs=[]
        sart(A,p,iterations=20,relaxation=relax,nonnegative=True,callback=lambda st: errs.append(s.error(st.volume)) if st.update+1==len(A) else None)
        best[relax]=min(errs), int(np.argmin(errs))+1
    out["sart"]=min(best.values()); out["t_sart"]=time.time()-t
    t=time.time(); v=fast(A,p,photons=s.photons); out["fast"]=s.error(v.array); out["t_fast"]=time.time()-t
    levels=[]
    for factor in (2,1):
        if factor==2:
            Ac=A.on(A.grid.with_voxels(2*A.grid.voxel,0*A.grid.voxel),A.geometry.binned(2,2)); pc,_=binned(p,None,(2,2))
            photons=None if s.photons is None else 4*s.photons
            tr=s.truth.reshape(size//2,2,size//2,2,size//2,2).mean((1,3,5)); near=s.near[::2,::2,::2]
        else: Ac,pc,photons,tr,near=A,p,s.photons,s.truth,s.near
        err=lambda x: float(np.sqrt(np.mean((x-tr)[near]**2,dtype=np.float64)))/s.mu
        a=float(Ac.grid.voxel.mean())
        mv=(s.mu*a)**2/6
        w=1/(noise_var(pc,photons)+mv)
        V=a**3
        n=len(Ac); k=max(1,round(n/10)); 
        out_views=sorted(subsets_of(Ac.geometry,10)[0]); used=sorted(set(range(n))-set(out_views))
        for which in ("all","part"):
            B,q,ww=(Ac,pc,w) if which=="all" else (Ac[used],pc[used],w[used])
            x=sart(B,q,iterations=3,relaxation=1.0,nonnegative=True).array.copy()
            parts=[(B[v],v) for v in subsets_of(B.geometry,10)]
            _,mean=_curvature(parts,_trust(B,ww,None))
            for e in np.arange(4,-7,-1):   # strength relative to 1/(mu mm^2)
                beta=10.0*2.0**e/s.mu
                reg=beta*V/mean
                x=minimised(B,q,x,Variation(B,reg,10,np.float32(0)),iterations=10,rounds=1,subsets=min(10,len(B)),weights=ww,huber=None,mask=None,callback=None).array.copy()
                row={"factor":factor,"which":which,"e":int(e),"err":err(x)}
                if which=="part":
                    r=remainder(Ac[out_views],x,pc,out_views,None)
                    row["cv"]=float(np.mean(np.square(r)*w[out_views])); row["cvu"]=rms(r)
                    row["cvnoise"]=float(np.mean(noise_var(pc,photons)[out_views]))
                else:
                    row["chi"]=float(np.mean([np.mean(np.square(remainder(Ac[[v]],x,pc,[v],None))*w[v]) for v in range(0,n,7)]))
                levels.append(row)
    out["rows"]=levels; out["t"]=time.time()-t
    return out
if __name__=="__main__":
    size=int(sys.argv[1]); 
    for seed in map(int,sys.argv[2:]):
        r=run(seed,size); print(json.dumps(r),flush=True)
