import sys; sys.path.insert(0,"/tmp/e60")
from exp1 import *
from twinct.recon.ray_weights import RayWeights,error_of_model
from twinct.recon.air import noise_in_air
from twinct.recon.levels import Level
from twinct.recon.order import spread_order,subset_number
from twinct.recon.working import WorkingVolume
from twinct.recon.ordered_subsets import Minimiser
import twinct.recon.strength as ST
def newfast(A,p,photons,passes=3,sart_passes=1,coarse=2,levels=3,relax=1.5,cb=None,extra_coarse=0,times=None,tol=0.0):
    known=None if photons is None else np.full(len(A),float(photons))
    noise=noise_in_air(p,None,known)
    before=None; rho=1.0; T=time.perf_counter(); times={} if times is None else times
    for factor in [2**n for n in reversed(range(levels))]:
        if min(*A.domain_shape,*A.range_shape[1:])//factor<8 and factor>1: continue
        level=Level.of(A,p,None,factor,0.0,before); work=WorkingVolume(A.kernels,level.start())
        k=sart_passes if factor==1 else max(1,round(coarse*factor/2))
        n=k*len(A)
        lastr=relax*min(1.0,float(np.mean(level.A.domain_shape))/len(A))
        for view,share in zip(np.resize(spread_order(len(A)),n),np.geomspace(relax,lastr,n) if n else []):
            level.update(work,int(view),float(share),0.0,False)
        x=work.array; times[f"sart{factor}"]=time.perf_counter()-T; T=time.perf_counter()
        if factor<=2:
            m2=error_of_model(level.A,x)
            nl=None if noise is None else type(noise)(noise.in_air/factor,noise.source)
            w=RayWeights.of(nl,len(A),m2)
            if factor==2:
                t=ST.trial(level,x,w,0.0)
                if t is not None: rho=t.factor
                times["trial"]=time.perf_counter()-T; T=time.perf_counter()
            if factor==1 or extra_coarse:
                m=Minimiser(level,x,w,0.0); m.strength=ST.Forces.of(m).strength(rho)
                for _ in range(passes if factor==1 else extra_coarse):
                    if factor==1 and tol and m.change<tol: break
                    m.one_pass()
                    if factor==1 and cb: cb(m.x)
                x=m.x
                times[f"os{factor}"]=time.perf_counter()-T; T=time.perf_counter()
        before=(level,level.whole(x)) if factor>1 else None
    return level.whole(x),rho
if __name__=="__main__":
  tot={}
  for l in open(sys.argv[1]):
    r=json.loads(l)
    s=random_scan(r["seed"],r["n"],CACHE); A,p=s.A,s.p
    best=min(q["err"] for q in r["rows"]) if "rows" in r else r["sart"][0]
    line=[f"{r['seed']} {r['family']:9s} v{len(A)} b/sart {best/r['sart'][0]:.2f} fast/sart {r['fast']/r['sart'][0]:.2f}"]
    for name,kw in json.loads(sys.argv[2]).items():
        errs=[]
        x,rho=newfast(A,p,s.photons,cb=lambda x: errs.append(s.error(x)/r['sart'][0]),**kw)
        line.append(f"| {name}: rho {np.log2(rho):.1f} "+" ".join(f"{e:.2f}" for e in errs))
        tot.setdefault(name,[]).append(errs)
    print(" ".join(line),flush=True)
  for k,v in tot.items():
    v=np.array(v); print(k,"median",np.median(v,0).round(3),"p95",np.percentile(v,95,axis=0).round(3),"max",v.max(0).round(3))
