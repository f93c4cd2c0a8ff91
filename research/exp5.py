import sys; sys.path.insert(0,"/tmp/e60")
from exp1 import *
import twinct.recon.ordered_subsets as OS
from twinct.recon.ray_weights import RayWeights,error_of_model
from twinct.recon.air import noise_in_air
from twinct.recon.levels import Level
from twinct.recon.order import spread_order
from twinct.recon.working import WorkingVolume
from twinct.recon.steps import Listener
def newfast(A,p,photons,passes=3,sart_passes=1,coarse=2,levels=3,relax=1.5,cb=None,strength=None,last=None):
    known=None if photons is None else np.full(len(A),float(photons))
    noise=noise_in_air(p,None,known)
    before=None
    for factor in [2**n for n in reversed(range(levels))]:
        if min(*A.domain_shape,*A.range_shape[1:])//factor<8 and factor>1: continue
        level=Level.of(A,p,None,factor,0.0,before); work=WorkingVolume(A.kernels,level.start())
        k=sart_passes if factor==1 else max(1,round(coarse*factor/2))
        n=k*len(A)
        lastr=relax*min(1.0,float(np.mean(level.A.domain_shape))/len(A))
        for view,share in zip(np.resize(spread_order(len(A)),n),np.geomspace(relax,lastr,n) if n else []):
            level.update(work,int(view),float(share),0.0,False)
        x=work.array
        before=(level,level.whole(x)) if factor>1 else None
    m2=error_of_model(level.A,x)
    w=RayWeights.of(noise,len(A),m2)
    x,course=OS.minimise(level,x,w,strength,0.0,passes,Listener(cb,0))
    return level.whole(x),course,m2
if __name__=="__main__":
  import json
  tot={}
  for l in open(sys.argv[1]):
    r=json.loads(l)
    s=random_scan(r["seed"],r["n"],CACHE); A,p=s.A,s.p
    best=min(q["err"] for q in r["rows"]) if "rows" in r else r["sart"][0]
    line=[f"{r['seed']} {r['family']:9s} v{len(A)} b/sart {best/r['sart'][0]:.2f} fast/sart {r['fast']/r['sart'][0]:.2f}"]
    for name,kw in json.loads(sys.argv[2]).items():
        errs=[]; ns=len(subsets_of(A.geometry,max(1,round(len(A)/10)))) if False else None
        from twinct.recon.order import subset_number
        ns=subset_number(None,len(A))
        t=time.perf_counter()
        x,c,m2=newfast(A,p,s.photons,cb=lambda st: errs.append(s.error(st.volume)/r['sart'][0]) if (st.update+1)%ns==0 else None,**kw)
        t=time.perf_counter()-t
        line.append(f"| {name}: "+" ".join(f"{e:.2f}" for e in errs))
        tot.setdefault(name,[]).append(errs)
    print(" ".join(line),flush=True)
  for k,v in tot.items():
    v=np.array(v); print(k,"median",np.median(v,0).round(3),"p95",np.percentile(v,95,axis=0).round(3),"max",v.max(0).round(3))
